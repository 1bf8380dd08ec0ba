//! Tests of the token that lets a monitor watch a node.

use imrs_wire::obs::{Challenge, MAX_TOKEN, Token, TokenError};

#[test]
fn only_the_token_of_the_node_proves_itself_and_only_for_one_challenge() {
    let token = |text: &str| Token::of(text).unwrap();
    let (challenge, another) = (Challenge([1; 32]), Challenge([2; 32]));
    let ours = token("0123456789abcdef\n");
    let proof = ours.proof(&challenge);
    assert!(token("0123456789abcdef").is_proven(&challenge, &proof));
    assert!(!ours.is_proven(&another, &proof));
    for other in ["0123456789abcdeF", "0123456789abcdef0", "1123456789abcdef"] {
        assert!(!token(other).is_proven(&challenge, &proof), "{other}");
    }
    for bit in 0..256 {
        let mut wrong = proof;
        wrong.0[bit / 8] ^= 1 << (bit % 8);
        assert!(!ours.is_proven(&challenge, &wrong));
    }
}

#[test]
fn a_token_is_hard_to_guess_and_never_shown() {
    assert_eq!(Token::of(" too short \n"), Err(TokenError));
    assert_eq!(Token::of(&"x".repeat(MAX_TOKEN + 1)), Err(TokenError));
    assert_eq!(format!("{:?}", Token::of("0123456789abcdef").unwrap()), "Token(..)");
}
