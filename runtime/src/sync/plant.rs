//! Planted bugs that the explorers must find: each piece marks where it could be wrong, and asks there whether the bug is
//! planted.

/// Which bugs are planted in a piece.
pub(crate) trait Plants<Bug> {
    fn has(&self, bug: Bug) -> bool;
}

/// No bug: what programs run. The compiler removes the question.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Sound;

impl<Bug> Plants<Bug> for Sound {
    #[inline]
    fn has(&self, _bug: Bug) -> bool {
        false
    }
}

/// At most one bug: what explorers run.
#[cfg(test)]
impl<Bug: PartialEq> Plants<Bug> for Option<Bug> {
    fn has(&self, bug: Bug) -> bool {
        self.as_ref() == Some(&bug)
    }
}
