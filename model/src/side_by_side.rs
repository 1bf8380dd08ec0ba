//! Runs workers on several threads.

use std::thread;

/// Runs each worker: the first on this thread, the others on threads of their own. A worker whose thread cannot be started
/// is left out; if workers take their work from a shared queue, the others then do its share.
///
/// # Panics
/// If a worker panics.
pub fn side_by_side<W: Send>(workers: impl IntoIterator<Item = W>, work: impl Fn(W) + Sync) {
    let mut workers = workers.into_iter();
    let Some(first) = workers.next() else { return };
    let work = &work;
    thread::scope(|scope| {
        for worker in workers {
            drop(thread::Builder::new().spawn_scoped(scope, move || work(worker)));
        }
        work(first);
    });
}
