//! stub
use crate::{ast, diagnostic::Diagnostic, hir::Hir};
pub(crate) fn all(_: &Hir) -> Vec<Diagnostic> { Vec::new() }
pub(crate) fn paper(_: &ast::File, _: &Hir) -> Vec<Diagnostic> { Vec::new() }
