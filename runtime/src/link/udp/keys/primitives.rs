//! The cryptography behind the handshakes: X25519 by `curve25519-dalek`, BLAKE2s by `blake2`, and the cipher and random
//! numbers by `ring`.
//!
//! `snow` has the first two itself, but only together with a second cipher (D203). Here the private keys are erased, too.

use super::{KEY_BYTES, PATTERN, SecretKey};
use blake2::{Blake2s256, Digest};
use curve25519_dalek::montgomery::MontgomeryPoint;
use snow::params::{CipherChoice, DHChoice, HashChoice};
use snow::resolvers::{CryptoResolver, RingResolver};
use snow::types::{Cipher, Dh, Hash, Random};
use zeroize::Zeroize;

/// Begins a handshake, or draws keys for one.
pub(super) fn builder<'a>() -> Result<snow::Builder<'a>, snow::Error> {
    Ok(snow::Builder::with_resolver(PATTERN.parse()?, Box::new(Primitives)))
}

struct Primitives;

impl CryptoResolver for Primitives {
    fn resolve_rng(&self) -> Option<Box<dyn Random>> {
        RingResolver.resolve_rng()
    }

    fn resolve_dh(&self, choice: &DHChoice) -> Option<Box<dyn Dh>> {
        matches!(choice, DHChoice::Curve25519).then(|| Box::<KeyPair>::default() as Box<dyn Dh>)
    }

    fn resolve_hash(&self, choice: &HashChoice) -> Option<Box<dyn Hash>> {
        matches!(choice, HashChoice::Blake2s).then(|| Box::<Blake2s>::default() as Box<dyn Hash>)
    }

    fn resolve_cipher(&self, choice: &CipherChoice) -> Option<Box<dyn Cipher>> {
        RingResolver.resolve_cipher(choice)
    }
}

/// A private key of X25519, which is erased from memory when it is dropped, and the public key that belongs
/// to it.
#[derive(Default)]
struct KeyPair {
    private: SecretKey,
    public: [u8; KEY_BYTES],
}

impl KeyPair {
    fn publish(&mut self) {
        self.public = MontgomeryPoint::mul_base_clamped(*self.private).to_bytes();
    }
}

impl Dh for KeyPair {
    fn name(&self) -> &'static str {
        "25519"
    }

    fn pub_len(&self) -> usize {
        KEY_BYTES
    }

    fn priv_len(&self) -> usize {
        KEY_BYTES
    }

    fn set(&mut self, private: &[u8]) {
        self.private.copy_from_slice(private);
        self.publish();
    }

    fn generate(&mut self, random: &mut dyn Random) -> Result<(), snow::Error> {
        random.try_fill_bytes(&mut *self.private)?;
        self.publish();
        Ok(())
    }

    fn pubkey(&self) -> &[u8] {
        &self.public
    }

    fn privkey(&self) -> &[u8] {
        &*self.private
    }

    fn dh(&self, public: &[u8], out: &mut [u8]) -> Result<(), snow::Error> {
        let public = public.first_chunk().ok_or(snow::Error::Dh)?;
        let mut shared = MontgomeryPoint(*public).mul_clamped(*self.private);
        out.first_chunk_mut().ok_or(snow::Error::Dh).map(|out| *out = shared.0)?;
        shared.zeroize();
        Ok(())
    }
}

#[derive(Default)]
struct Blake2s(Blake2s256);

impl Hash for Blake2s {
    fn name(&self) -> &'static str {
        "BLAKE2s"
    }

    fn block_len(&self) -> usize {
        64
    }

    fn hash_len(&self) -> usize {
        32
    }

    fn reset(&mut self) {
        self.0 = Blake2s256::default();
    }

    fn input(&mut self, data: &[u8]) {
        self.0.update(data);
    }

    fn result(&mut self, out: &mut [u8]) {
        let hash = std::mem::take(&mut self.0).finalize();
        out[..hash.len()].copy_from_slice(&hash);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn hex(bytes: &[u8]) -> String {
        bytes.iter().map(|byte| format!("{byte:02x}")).collect()
    }

    /// RFC 7748, section 5.2: each result is the next key, and the key before it is the next point.
    #[test]
    fn keys_are_agreed_on_as_the_standard_says() {
        let mut point = [0; KEY_BYTES];
        point[0] = 9;
        let mut pair = KeyPair::default();
        let mut private = point;
        for round in 1..=1_000 {
            pair.set(&private);
            assert_eq!(pair.privkey(), private);
            let mut out = [0; 56];
            pair.dh(&point, &mut out).unwrap();
            point = std::mem::replace(&mut private, *out.first_chunk().unwrap());
            if round == 1 {
                assert_eq!(pair.pubkey(), private, "9 is the base point");
                let one = "422c8e7a6227d7bca1350b3e2bb7279f7897b87bb6854b783c60e80311ae3079";
                assert_eq!(hex(&private), one);
            }
        }
        assert_eq!(hex(&private), "684cf59ba83309552800ef566f2f4d3c1c3887c49360e3875f2eb94d99532c51");
        assert!(pair.dh(&point[1..], &mut [0; 56]).is_err());
    }

    /// RFC 7693, appendix B.
    #[test]
    fn hashes_are_those_of_the_standard_also_when_begun_again() {
        let (mut hash, mut out) = (Blake2s::default(), [0; 64]);
        hash.input(b"something else");
        hash.reset();
        for _ in 0..2 {
            hash.input(b"ab");
            hash.input(b"c");
            hash.result(&mut out);
            let abc = "508c5e8c327c14e2e1a72ba34eeb452f37458b209ed63a294d999b4c86675982";
            assert_eq!(hex(&out[..hash.hash_len()]), abc);
        }
    }
}
