//! Bugs that are planted on purpose, and that the explorers of schedules (loom and shuttle) must find. A data
//! structure asks at each place that could be wrong whether a bug is planted there.

/// The bugs that are planted in a data structure.
pub(crate) trait Plants<Bug> {
    fn has(&self, bug: Bug) -> bool;
}

/// Plants no bug: programs use this. The compiler removes the calls of `has`.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Sound;

impl<Bug> Plants<Bug> for Sound {
    #[inline]
    fn has(&self, _bug: Bug) -> bool {
        false
    }
}

/// Plants at most one bug: loom and shuttle use this.
#[cfg(test)]
impl<Bug: PartialEq> Plants<Bug> for Option<Bug> {
    fn has(&self, bug: Bug) -> bool {
        self.as_ref() == Some(&bug)
    }
}
