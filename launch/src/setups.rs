//! Builds the setup that each node of a run gets at its start.

use crate::error::LaunchError;
use crate::pipe::Setup;
use crate::run::{Keys, Run};
use imrs_client::keys::{self, KeyText};
use imrs_client::place::{self, observed_at};
use imrs_protocol::NodeId;
use std::path::{Path, PathBuf};

/// The setups of all nodes that this launcher runs.
///
/// # Errors
/// An error if the only node that this launcher runs has no address, or if the keys cannot be used.
pub fn setups(run: &Run<'_>, notices: Option<&Path>) -> Result<Vec<(NodeId, Setup)>, LaunchError> {
    let cell = run.loaded.table.cell();
    let mut keys = keys_of(run)?;
    let mut all = Vec::new();
    for (i, node) in cell.nodes.iter().enumerate() {
        let id = NodeId::from_index(i);
        if run.only.is_some_and(|only| only != id) {
            continue;
        }
        let mut setup = Setup {
            cell: run.source.clone(),
            node: node.name.clone(),
            incarnation: 0,
            restarted: false,
            // A node that runs alone counts its incarnations itself, because its neighbours may remember an earlier one
            // (D49).
            counts: run.only.is_some(),
            bind: None,
            keys: keys.get_mut(i).and_then(Option::take),
            insecure: !run.in_process && run.keys == Keys::Checksums,
            // The nodes take successive ports.
            observe: run.observe.map(|first| observed_at(first, all.len())),
            observe_token: run.observe_token.clone(),
            rt: run.rt,
            seed: run.seed,
            loss: run.loss,
            record: run.record.as_ref().map(|file| record_file(file, &node.name)),
            force: run.force,
            actions: run.actions.clone(),
            notices: notices.map(Path::to_owned),
            ramps: run.ramps.clone(),
        };
        if run.only.is_some() {
            setup.bind = Some(place::address(run.loaded, id)?);
        }
        all.push((id, setup));
    }
    Ok(all)
}

/// The keys of each node that this launcher runs, by the node's id.
fn keys_of(run: &Run<'_>) -> Result<Vec<Option<KeyText>>, LaunchError> {
    match (&run.keys, run.only) {
        (Keys::Drawn, _) if !run.in_process => Ok(keys::draw(run.loaded)?.into_iter().map(Some).collect()),
        (Keys::Folder(folder), Some(only)) => {
            let (text, _) = keys::read(folder, run.loaded, only)?;
            let mut all = vec![None; only.index()];
            all.push(Some(text));
            Ok(all)
        }
        _ => Ok(Vec::new()),
    }
}

/// The recording file of one node: `run.imrs` becomes `run.nl.imrs`.
#[must_use]
pub fn record_file(file: &Path, node: &str) -> PathBuf {
    let extension = file.extension().map_or_else(|| "imrs".into(), |e| e.to_string_lossy());
    file.with_extension(format!("{node}.{extension}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_node_records_into_a_file_of_its_own() {
        assert_eq!(record_file(Path::new("/r/run.imrs"), "nl"), Path::new("/r/run.nl.imrs"));
        assert_eq!(record_file(Path::new("run"), "nr"), Path::new("run.nr.imrs"));
    }
}
