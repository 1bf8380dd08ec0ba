//! The key files of a cell's nodes (D191): one file for each node, with its own private key, the public keys of the
//! other nodes, and the cell's key.
//!
//! ```text
//! imrs-keys 1
//! cell 00…ff
//! node nl 00…ff
//! peer nr 00…ff
//! ```

use crate::cells::Loaded;
use crate::error::PlaceError;
use imrs_protocol::{NodeId, NodeTable};
use imrs_runtime::link::udp::keys::{
    KEY_BYTES, NoRandom, NodeKeys, SecretKey, draw_cell_key, draw_node_keys,
};
use imrs_wire::files;
use imrs_wire::obs::place::file_name;
use rustix::process::{DumpableBehavior, set_dumpable_behavior};
use std::collections::BTreeMap;
use std::fmt::Write;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use zeroize::Zeroizing;

/// The text of a key file. It is erased from memory when it is dropped.
pub type KeyText = Zeroizing<String>;

/// The first line of each key file.
const FIRST: &str = "imrs-keys 1";
/// The greatest length of a key file, in bytes: more than the keys of all nodes that a cell can have.
const LONGEST: u64 = 1 << 20;

/// The folder in which a cell's keys are kept unless the user names another folder: `line.keys` beside `line.cell`.
#[must_use]
pub fn beside(cell: &Path) -> PathBuf {
    cell.with_extension("keys")
}

/// The path of a node's key file in a folder of keys.
#[must_use]
pub fn file_of(folder: &Path, node: &str) -> PathBuf {
    folder.join(format!("{}.keys", file_name(node)))
}

/// Draws keys for a cell. Returns the text of each node's key file, in the order of the nodes. The memory of this
/// process is private from now on.
///
/// # Errors
/// [`PlaceError::NoNewKeys`].
pub fn draw(loaded: &Loaded) -> Result<Vec<KeyText>, PlaceError> {
    make_memory_private().map_err(PlaceError::NoNewKeys)?;
    drawn(loaded).map_err(|error| PlaceError::NoNewKeys(error.to_string()))
}

fn drawn(loaded: &Loaded) -> Result<Vec<KeyText>, NoRandom> {
    let cell = draw_cell_key()?;
    let nodes = &loaded.table.cell().nodes;
    let pairs = nodes.iter().map(|_| draw_node_keys()).collect::<Result<Vec<_>, _>>()?;
    let line = |word: &str, name: &str| FIRST.len() + word.len() + name.len() + 2 * KEY_BYTES + 3;
    // The text never grows beyond this room, so that no copy of it is left behind.
    let most = line("", "") + nodes.iter().map(|node| line("node", &node.name)).sum::<usize>();
    let text = |at: usize| {
        let mut text = KeyText::new(String::with_capacity(most));
        text.extend([FIRST, "\ncell "]);
        push_hex(&mut text, &cell);
        for (other, (node, (private, public))) in nodes.iter().zip(&pairs).enumerate() {
            let (word, key) = if other == at { ("\nnode ", &**private) } else { ("\npeer ", public) };
            text.extend([word, &node.name, " "]);
            push_hex(&mut text, key);
        }
        text.push('\n');
        text
    };
    Ok((0..nodes.len()).map(text).collect())
}

/// Reads the keys of a node from its key file in a folder. Also returns the text of the file. The memory of this
/// process is private from now on.
///
/// # Errors
/// [`PlaceError::Keys`]: there is no such file, others can read it, or it contains no keys of this node.
pub fn read(folder: &Path, loaded: &Loaded, node: NodeId) -> Result<(KeyText, NodeKeys), PlaceError> {
    let path = file_of(folder, &loaded.table.cell().nodes[node.index()].name);
    let failed = |why: String| PlaceError::Keys { path: path.clone(), why };
    make_memory_private().map_err(failed)?;
    let text = files::secret(&path, LONGEST).map_err(|error| failed(error.to_string()))?;
    let text = KeyText::new(text);
    let keys = parse(&text, loaded, node).map_err(failed)?;
    Ok((text, keys))
}

/// Reads the keys of a node from the text of its key file. The memory of this process is private from now on.
///
/// # Errors
/// Says why the text contains no keys of this node.
pub fn parse(text: &str, loaded: &Loaded, node: NodeId) -> Result<NodeKeys, String> {
    make_memory_private()?;
    let keys = lines(text, loaded, &loaded.table.cell().nodes[node.index()].name)?;
    let table = NodeTable::new(Arc::clone(&loaded.table), node);
    let missing = table.neighbours(node).find(|&peer| !keys.has(peer));
    missing.map_or(Ok(keys), |peer| {
        let peer = &loaded.table.cell().nodes[peer.index()].name;
        Err(format!("it has no key of node `{peer}`: make new keys of this cell for all nodes"))
    })
}

/// From now on the memory of this process goes into no core file and to no core handler. No process of the same user
/// may read it or attach to this process (`prctl(2)`, PR_SET_DUMPABLE). A command that this process starts is not
/// protected.
fn make_memory_private() -> Result<(), String> {
    set_dumpable_behavior(DumpableBehavior::NotDumpable)
        .map_err(|error| format!("core files cannot be switched off: {error}"))
}

fn lines(text: &str, loaded: &Loaded, name: &str) -> Result<NodeKeys, String> {
    let mut lines = text.lines().enumerate();
    if lines.next().map(|(_, first)| first) != Some(FIRST) {
        return Err(format!("its first line is not `{FIRST}`"));
    }
    let nodes = &loaded.table.cell().nodes;
    let (mut cell, mut private, mut publics) = (None, None, BTreeMap::new());
    for (at, line) in lines {
        let wrong = || format!("line {} is no key", at + 1);
        let words: Vec<&str> = line.split(' ').collect();
        let key = words.last().and_then(|word| unhex(word)).ok_or_else(wrong)?;
        match words[..] {
            ["cell", _] => cell = Some(key),
            ["node", of, _] if of == name => private = Some(key),
            ["node", of, _] => return Err(format!("it is the file of node `{of}`")),
            ["peer", of, _] => {
                // The file may list a node that the cell no longer has. Its key is not needed.
                let peer = nodes.iter().position(|node| node.name == of).map(NodeId::from_index);
                publics.extend(peer.map(|peer| (peer, *key)));
            }
            _ => return Err(wrong()),
        }
    }
    let cell = cell.ok_or("it has no key of the cell")?;
    let private = private.ok_or_else(|| format!("it has no key of node `{name}`"))?;
    Ok(NodeKeys::new(cell, private, publics))
}

fn push_hex(text: &mut String, key: &[u8; KEY_BYTES]) {
    for byte in key {
        // Writing to a string cannot fail.
        let _ = write!(text, "{byte:02x}");
    }
}

fn unhex(text: &str) -> Option<SecretKey> {
    let mut key = SecretKey::default();
    let (pairs, rest) = text.as_bytes().as_chunks::<2>();
    if pairs.len() != KEY_BYTES || !rest.is_empty() {
        return None;
    }
    for (byte, pair) in key.iter_mut().zip(pairs) {
        let digit = |at: usize| char::from(pair[at]).to_digit(16).and_then(|digit| u8::try_from(digit).ok());
        *byte = digit(0)? << 4 | digit(1)?;
    }
    Some(key)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rustix::process::dumpable_behavior;
    use std::fs;
    use std::os::unix::fs::PermissionsExt;

    const CELL: &str = "cell two;
tick 1 msec;
node na;
node nb;
link na -- nb delay 1 msec;
task left on na extern
end left;
task right on nb extern
end right;
";

    /// A folder with the keys of the cell.
    fn kept(loaded: &Loaded) -> tempfile::TempDir {
        let folder = tempfile::tempdir().unwrap();
        for (node, text) in loaded.table.cell().nodes.iter().zip(draw(loaded).unwrap()) {
            let path = file_of(folder.path(), &node.name);
            fs::write(&path, &*text).unwrap();
            fs::set_permissions(path, fs::Permissions::from_mode(0o600)).unwrap();
        }
        folder
    }

    #[test]
    fn each_node_reads_its_own_file_and_nothing_else() {
        let loaded = crate::cells::load("two.cell", CELL, false).unwrap();
        let folder = kept(&loaded);
        for node in [0, 1] {
            let (text, keys) = read(folder.path(), &loaded, NodeId(node)).unwrap();
            assert!(keys.has(NodeId(1 - node)) && !keys.has(NodeId(node)));
            assert_eq!(
                *text,
                fs::read_to_string(file_of(folder.path(), ["na", "nb"][node as usize])).unwrap()
            );
        }
        // The kernel gives the memory of this process to no file and no other process.
        assert_eq!(dumpable_behavior().unwrap(), DumpableBehavior::NotDumpable);
        let [na, nb] = ["na", "nb"].map(|node| file_of(folder.path(), node));
        let text = fs::read_to_string(&na).unwrap();
        let refused = |text: &str, words: &str| {
            fs::write(&na, text).unwrap();
            let said = read(folder.path(), &loaded, NodeId(0)).err().map(|error| error.to_string());
            let said = said.unwrap_or_default();
            assert!(said.contains(words) && said.contains("imrs keygen"), "`{words}`: {said}");
        };
        refused(&fs::read_to_string(&nb).unwrap(), "the file of node `nb`");
        refused(&text.replace("keys 1", "keys 2"), "first line");
        refused(&text.replace("cell ", "cell 0"), "line 2 is no key");
        refused(&text.replace("peer nb", "peer nx"), "no key of node `nb`");
        refused(&text.replace("cell ", "peer c "), "no key of the cell");
        fs::write(&na, &text).unwrap();
        fs::set_permissions(&na, fs::Permissions::from_mode(0o640)).unwrap();
        assert!(read(folder.path(), &loaded, NodeId(0)).unwrap_err().to_string().contains("chmod 600"));
        fs::remove_file(&na).unwrap();
        assert!(read(folder.path(), &loaded, NodeId(0)).unwrap_err().to_string().contains("na.keys"));
    }
}
