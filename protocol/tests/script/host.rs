//! Scripts on whole nodes.
