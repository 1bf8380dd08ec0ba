//! Builds the verifiers of the Promela models with SPIN and the C compiler. That takes much longer than running most of
//! them, so the built programs stay in cargo's target folder, and each is built once. Each call runs a verifier again.

use super::spin;
use std::fs;
use std::hash::{DefaultHasher, Hash, Hasher};
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::LazyLock;

/// The folder that keeps the built verifiers between test runs.
const BUILT: &str = concat!(env!("CARGO_TARGET_TMPDIR"), "/twins");

/// The compiler flags for most verifiers. They explore so few states that optimising would take longer than it saves.
const QUICKLY_BUILT: &[&str] = &["-O0"];

/// The compiler flags for a verifier that explores a million states.
pub const OPTIMISED: &[&str] = &["-O2"];

/// The versions of SPIN and the C compiler, and the arguments with which they are called. If any of these changes, the
/// verifiers are built again.
static TOOLS: LazyLock<String> = LazyLock::new(|| {
    let version = |program: &str, flag: &str| {
        let output = Command::new(program).arg(flag).output().expect("it was found to be here");
        String::from_utf8_lossy(&output.stdout).into_owned()
    };
    let compiler = std::env::var("CC").unwrap_or_else(|_| "cc".into());
    let starts: &str = include_str!("../../model/tests/support/spin.rs");
    let (compilers, spins) = (version(&compiler, "--version"), version("spin", "-V"));
    [&compiler, &compilers, &spins, starts].join("\n")
});

/// A Promela model with its definitions, and the flags with which its verifier is compiled.
pub struct Twin<'a> {
    model: &'a str,
    definitions: &'a [&'a str],
    flags: &'static [&'static str],
}

impl<'a> Twin<'a> {
    /// The twin for a model file in `specs/promela`. Each of the `definitions` is `NAME` or `NAME=value`.
    pub const fn new(model: &'a str, definitions: &'a [&'a str]) -> Self {
        Self { model, definitions, flags: QUICKLY_BUILT }
    }

    /// The same twin, whose verifier is compiled with these flags.
    pub const fn compiled(self, flags: &'static [&'static str]) -> Self {
        Self { flags, ..self }
    }

    /// Runs the verifier, which explores the whole model. Returns its verdict.
    pub fn verdict(&self) -> spin::Verdict {
        let folder = tempfile::tempdir().expect("a folder for temporary files");
        spin::Verifier::at(self.verifier()).run_in(folder.path(), &["-w20"])
    }

    /// The path of the twin's verifier. The verifier is built if it does not exist.
    fn verifier(&self) -> PathBuf {
        let model = Path::new(env!("CARGO_MANIFEST_DIR")).join("specs/promela").join(self.model);
        let text = fs::read_to_string(&model).unwrap_or_else(|e| panic!("{}: {e}", model.display()));
        let made_of = format!("{:?} {:?}\n{}\n{text}", self.definitions, self.flags, *TOOLS);
        let mut hash = DefaultHasher::new();
        made_of.hash(&mut hash);
        let folder = Path::new(BUILT).join(format!("{}-{:016x}", self.model, hash.finish()));
        if !is_built(&folder, &made_of) {
            self.build(&model, &folder, &made_of);
        }
        folder.join("pan")
    }

    fn build(&self, model: &Path, folder: &Path, made_of: &str) {
        fs::create_dir_all(BUILT).expect("a folder in cargo's target folder");
        let new = tempfile::tempdir_in(BUILT).expect("a folder beside the verifiers");
        let definitions: Vec<String> = self.definitions.iter().map(|&definition| definition.into()).collect();
        let pan = spin::build(new.path(), model, &definitions, self.flags);
        // The folder gets its final name only when it is complete. An aborted test therefore leaves no incomplete
        // verifier that another test would run.
        let whole = new.path().join("whole");
        fs::create_dir(&whole).expect("a folder");
        fs::rename(pan.path(), whole.join("pan")).expect("the verifier is moved");
        fs::write(whole.join("made_of"), made_of).expect("written");
        match fs::rename(&whole, folder) {
            Ok(()) => {}
            // Another test program has built the same verifier in the meantime.
            Err(e) if e.kind() == ErrorKind::DirectoryNotEmpty && is_built(folder, made_of) => {}
            Err(e) => panic!("{}: {e}: remove this folder", folder.display()),
        }
    }
}

/// Whether a folder contains a verifier that was built from these inputs.
fn is_built(folder: &Path, made_of: &str) -> bool {
    fs::read_to_string(folder.join("made_of")).is_ok_and(|text| text == made_of)
}
