//! Reads the inputs that are kept for the fuzz targets, so that the crates' tests can run them.

use std::path::Path;

/// The kept inputs of a fuzz target, each with its name. `fuzz/seeds.py` writes the files.
pub fn seeds(target: &str) -> Vec<(String, Vec<u8>)> {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("../fuzz/seeds/{target}.txt"));
    let text = std::fs::read_to_string(&file).unwrap_or_else(|e| panic!("{}: {e}", file.display()));
    text.lines().map(|line| seed(line).unwrap_or_else(|| panic!("{}: {line}", file.display()))).collect()
}

/// Reads one line of a file of inputs: a name, a tab, and the bytes in hexadecimal.
fn seed(line: &str) -> Option<(String, Vec<u8>)> {
    let (name, digits) = line.split_once('\t')?;
    let pairs = digits.len().is_multiple_of(2).then(|| (0..digits.len()).step_by(2))?;
    let byte = |at| u8::from_str_radix(digits.get(at..at + 2)?, 16).ok();
    Some((name.to_owned(), pairs.map(byte).collect::<Option<_>>()?))
}
