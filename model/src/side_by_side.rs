//! Work that threads share.

use std::thread;

/// Lets each worker work: the first in this thread, the others in threads beside it as far as there is room for them. Work that
/// goes to whoever asks for it next is done by those that there are.
///
/// # Panics
/// A worker does.
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
