//! Wakes a thread of a node that waits in the node's link (in its socket).

use crate::link::{Leading, Link};
use crate::sync::handoff::ThreadWaker;
use std::sync::Arc;

/// Makes the waker for a thread of the node that waits in the node's link.
pub(crate) fn link_waker(link: Option<&Arc<dyn Link>>) -> Option<Arc<dyn ThreadWaker>> {
    link.map(|link| Arc::new(LinkWaker(Arc::clone(link))) as Arc<dyn ThreadWaker>)
}

/// Wakes a thread that waits in the link's socket.
struct LinkWaker(Arc<dyn Link>);

impl ThreadWaker for LinkWaker {
    fn wake(&self) {
        self.0.leading().into_iter().for_each(Leading::call);
    }
}
