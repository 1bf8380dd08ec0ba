//! imrs
fn main() {}
