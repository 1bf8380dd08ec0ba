//! Libraries that people might use in place of imrs, added to the suites in which they are compared.

#[cfg(feature = "peers")]
mod actors;
#[cfg(feature = "peers")]
mod channels;
#[cfg(feature = "messaging-peers")]
mod messaging;
#[cfg(feature = "network-peers")]
mod network;
#[cfg(feature = "peers")]
mod posts;

use crate::suite::Suite;

/// Adds to the suites the libraries that the features of this build name.
pub fn join(suites: &mut [Suite]) {
    for suite in suites {
        #[cfg(feature = "peers")]
        {
            channels::join(suite);
            actors::join(suite);
        }
        #[cfg(feature = "network-peers")]
        network::join(suite);
        #[cfg(feature = "messaging-peers")]
        messaging::join(suite);
        #[cfg(not(any(feature = "peers", feature = "network-peers", feature = "messaging-peers")))]
        let _ = suite;
    }
}
