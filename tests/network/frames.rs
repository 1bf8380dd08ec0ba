//! The frames that hosts send: Ethernet, with IPv4 and UDP in it.

/// Where the parts of a frame begin. The hosts send IPv4 headers without options.
const IP: usize = 14;
const UDP: usize = IP + 20;
const PAYLOAD: usize = UDP + 8;
/// The last byte of the receiver's hardware address.
const TO: usize = 5;

/// The hardware address of a host, by its number.
pub fn hardware_address(host: usize) -> String {
    format!("02:00:00:00:00:{:02x}", host + 1)
}

/// The host for which a frame is; `None` if the frame is for all hosts.
pub fn receiver(frame: &[u8]) -> Option<usize> {
    let to = frame.get(..=TO)?;
    (to[..TO] == [2, 0, 0, 0, 0]).then(|| usize::from(to[TO]).checked_sub(1)).flatten()
}

/// Whether a frame carries a UDP datagram over IPv4. All other frames are noise of the hosts' kernels.
pub fn is_datagram(frame: &[u8]) -> bool {
    frame.len() > PAYLOAD && frame[12..IP] == [8, 0] && frame[IP] == 0x45 && frame[IP + 9] == 17
}

/// Whether a frame is part of ARP.
pub fn is_arp(frame: &[u8]) -> bool {
    frame.len() > IP && frame[12..IP] == [8, 6]
}

/// Flips one to three bits of a datagram's payload, chosen by `draw`. The UDP checksum is taken off, because otherwise
/// the receiver's kernel would drop the datagram, and the node would never see the damage.
pub fn damage(frame: &mut [u8], draw: u64) {
    let mut draws = fastrand::Rng::with_seed(draw);
    let bits = (frame.len() - PAYLOAD) * 8;
    for _ in 0..draws.usize(1..=3) {
        let bit = draws.usize(..bits);
        frame[PAYLOAD + bit / 8] ^= 1 << (bit % 8);
    }
    frame[UDP + 6..PAYLOAD].fill(0);
}

/// A frame with a datagram, as a host would send it.
#[cfg(test)]
pub fn datagram(to: usize, payload: &[u8]) -> Vec<u8> {
    let mut frame = vec![2, 0, 0, 0, 0, u8::try_from(to + 1).expect("a few hosts")];
    frame.resize(PAYLOAD, 0);
    (frame[12], frame[IP], frame[IP + 9]) = (8, 0x45, 17);
    frame.extend(payload);
    frame
}
