//! Bugs that explorers must find: each piece says where it could be wrong, and asks there whether it is.

/// Which bugs of a piece there are.
pub(crate) trait Plants<Bug> {
    fn has(&self, bug: Bug) -> bool;
}

/// None: what programs run. Nothing of the question is left there.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Sound;

impl<Bug> Plants<Bug> for Sound {
    #[inline]
    fn has(&self, _bug: Bug) -> bool {
        false
    }
}

/// One at most: what explorers run.
#[cfg(test)]
impl<Bug: PartialEq> Plants<Bug> for Option<Bug> {
    fn has(&self, bug: Bug) -> bool {
        self.as_ref() == Some(&bug)
    }
}
