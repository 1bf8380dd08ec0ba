//! Builds verifiers of the Promela models, each once. SPIN and the C compiler take much longer than most verifiers run, so
//! the built programs stay in cargo's target folder. Each call runs a verifier again.

use super::spin;
use std::fs;
use std::hash::{DefaultHasher, Hash, Hasher};
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::LazyLock;

/// The folder that keeps the verifiers between test runs.
const BUILT: &str = concat!(env!("CARGO_TARGET_TMPDIR"), "/twins");

/// The default compiler flags. Most verifiers explore so little that optimising them takes longer than it saves.
const QUICKLY_BUILT: &[&str] = &["-O0"];

/// The flags for a verifier that explores a million states.
pub const OPTIMISED: &[&str] = &["-O2"];

/// The versions of SPIN and the C compiler, and how they are called. If any changes, verifiers are built again.
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

/// A Promela model with definitions, and how its verifier is compiled.
pub struct Twin<'a> {
    model: &'a str,
    definitions: &'a [&'a str],
    flags: &'static [&'static str],
}

impl<'a> Twin<'a> {
    /// The twin for a model of `specs/promela`; each of `definitions` is `NAME` or `NAME=value`.
    pub const fn new(model: &'a str, definitions: &'a [&'a str]) -> Self {
        Self { model, definitions, flags: QUICKLY_BUILT }
    }

    /// The same twin, compiled with these flags.
    pub const fn compiled(self, flags: &'static [&'static str]) -> Self {
        Self { flags, ..self }
    }

    /// The verdict of the twin's verifier, which explores the whole model on each call.
    pub fn verdict(&self) -> spin::Verdict {
        let folder = tempfile::tempdir().expect("a folder for temporary files");
        spin::Verifier::at(self.verifier()).run_in(folder.path(), &["-w20"])
    }

    /// The path of the twin's verifier, which is built if it does not exist.
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
        // The folder gets its name only when it is complete, so an aborted test leaves no half-built verifier that
        // another test would run.
        let whole = new.path().join("whole");
        fs::create_dir(&whole).expect("a folder");
        fs::rename(pan.path(), whole.join("pan")).expect("the verifier is moved");
        fs::write(whole.join("made_of"), made_of).expect("written");
        match fs::rename(&whole, folder) {
            Ok(()) => {}
            // Another test has built the same verifier in the meantime.
            Err(e) if e.kind() == ErrorKind::DirectoryNotEmpty && is_built(folder, made_of) => {}
            Err(e) => panic!("{}: {e}: remove this folder", folder.display()),
        }
    }
}

/// Whether a folder contains a verifier that was built from these inputs.
fn is_built(folder: &Path, made_of: &str) -> bool {
    fs::read_to_string(folder.join("made_of")).is_ok_and(|text| text == made_of)
}
