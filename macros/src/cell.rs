//! Implements `cell!`, which turns a cell file into Rust items.

use crate::message::implementation;
use imrs_language::hir::{Field, Hir};
use imrs_language::lower::Behaviour;
use imrs_language::{Severity, Source, Unit, compile, render};
use imrs_protocol::script::Type;
use proc_macro2::{Ident, Literal, Span, TokenStream};
use quote::{format_ident, quote};
use std::fs;
use std::path::Path;
use syn::{LitStr, Member};

/// The items for a cell file, or a compile error with its diagnostics. In both cases a change of the file makes cargo
/// compile the program again.
pub fn expand(path: &LitStr) -> TokenStream {
    let folder = std::env::var_os("CARGO_MANIFEST_DIR").unwrap_or_default();
    let file = Path::new(&folder).join(path.value());
    let text = match fs::read(&file) {
        Ok(text) => text,
        Err(error) => {
            let error = format!("{}: {error}; it is named from the folder of Cargo.toml", path.value());
            return syn::Error::new(path.span(), error).to_compile_error();
        }
    };
    let file = file.to_string_lossy();
    let items = items(&path.value(), &text)
        .unwrap_or_else(|said| syn::Error::new(path.span(), said).to_compile_error());
    quote! {
        /// The text of the cell.
        pub const FILE: &str = include_str!(#file);
        #items
    }
}

/// The items for a cell, or the compiler's diagnostics as text.
fn items(name: &str, text: &[u8]) -> Result<TokenStream, String> {
    let shown = |found: &[_], source| {
        format!("the cell has errors\n{}", render::text(found, name, source, render::Style::Plain).trim_end())
    };
    let source = Source::new(text).map_err(|found| shown(&[*found], None))?;
    let compiled = compile(&source);
    let lowered = compiled.lower(Unit::Microseconds);
    let (Some(hir), Some(lowered)) = (&compiled.hir, lowered) else {
        let errors: Vec<_> =
            compiled.diagnostics.into_iter().filter(|found| found.severity == Severity::Error).collect();
        return Err(shown(&errors, Some(&source)));
    };
    let packed = |bytes: Result<Vec<u8>, postcard::Error>| {
        bytes.map(|bytes| Literal::byte_string(&bytes)).map_err(|error| error.to_string())
    };
    let cell = packed(postcard::to_allocvec(&lowered.cell))?;
    let mut scripts = Vec::new();
    for (task, behaviour) in hir.tasks.iter().zip(&lowered.tasks) {
        if let Behaviour::Script(script) = behaviour {
            let (name, node) = (&task.name, task.node.0);
            let program = packed(postcard::to_allocvec(&*script.program))?;
            scripts.push(quote!((#name, ::imrs_runtime::protocol::NodeId(#node), #program)));
        }
    }
    let names = names(hir);
    let types = types(hir);
    Ok(quote! {
        /// The table of the cell; its ticks are microseconds.
        pub fn table() -> ::std::sync::Arc<::imrs_runtime::protocol::CellTable> {
            static TABLE: ::std::sync::OnceLock<::std::sync::Arc<::imrs_runtime::protocol::CellTable>> =
                ::std::sync::OnceLock::new();
            ::std::sync::Arc::clone(TABLE.get_or_init(|| ::imrs_runtime::compiled::table(#cell)))
        }

        /// A node of the cell, with the scripts of its tasks.
        pub fn builder(node: ::imrs_runtime::protocol::NodeId) -> ::imrs_runtime::Builder {
            let scripts: &[(&str, ::imrs_runtime::protocol::NodeId, &[u8])] = &[#(#scripts),*];
            ::imrs_runtime::compiled::builder(table(), node, scripts)
        }

        #names
        #types
    })
}

/// A constant for each node, task and port.
fn names(hir: &Hir) -> TokenStream {
    let module = |name: &str, of: &str, all: &mut dyn Iterator<Item = &String>| {
        let (module, of) = (format_ident!("{name}"), format_ident!("{of}"));
        let constants = (0_u16..).zip(all).map(|(id, name)| {
            let (constant, line) = (ident(&name.to_uppercase()), format!("`{name}`."));
            quote! {
                #[doc = #line]
                pub const #constant: ::imrs_runtime::protocol::#of = ::imrs_runtime::protocol::#of(#id);
            }
        });
        let line = format!("The {name} of the cell.");
        quote! {
            #[doc = #line]
            #[allow(dead_code)]
            pub mod #module {
                #(#constants)*
            }
        }
    };
    let nodes = module("nodes", "NodeId", &mut hir.nodes.iter().map(|node| &node.name));
    let tasks = module("tasks", "TaskId", &mut hir.tasks.iter().map(|task| &task.name));
    let ports = module("ports", "PortId", &mut hir.ports.iter().map(|port| &port.name));
    quote!(#nodes #tasks #ports)
}

/// The structs of the records, and the types of each port's messages and answers.
fn types(hir: &Hir) -> TokenStream {
    let records = hir.records.iter().map(|record| {
        let line = format!("The record `{}`.", record.name);
        structure(&ident(&record.name), &line, &record.fields)
    });
    let mut own = Vec::new();
    let mut aliases = [Vec::new(), Vec::new()];
    for port in &hir.ports {
        let both = [("message", &port.message, port.record), ("answer", &port.answer, None)];
        for ((what, fields, record), aliases) in both.into_iter().zip(&mut aliases) {
            let (name, line) = (ident(&port.name), format!("The {what} of port `{}`.", port.name));
            let is = if fields.is_empty() {
                quote!(())
            } else if let Some(record) = record_of(hir, fields, record) {
                let record = ident(&record.name);
                quote!(super::#record)
            } else {
                let of = format_ident!("{}_{what}", plain(&port.name));
                own.push(structure(&of, &line, fields));
                quote!(super::#of)
            };
            aliases.push(quote! {
                #[doc = #line]
                pub type #name = #is;
            });
        }
    }
    let [messages, answers] = aliases;
    quote! {
        #(#records)*
        #(#own)*
        /// The type of the messages that are sent through each port.
        #[allow(non_camel_case_types, dead_code)]
        pub mod messages {
            #(#messages)*
        }
        /// The type of the answers that are sent through each port.
        #[allow(non_camel_case_types, dead_code)]
        pub mod answers {
            #(#answers)*
        }
    }
}

/// The record for these fields: the declared record if its types fit, or any record with the same names and types.
fn record_of<'a>(
    hir: &'a Hir,
    fields: &[Field],
    declared: Option<usize>,
) -> Option<&'a imrs_language::hir::Record> {
    let types = |fields: &[Field]| fields.iter().map(|field| field.of).collect::<Vec<_>>();
    let pairs = |fields: &[Field]| fields.iter().map(|f| (f.name.clone(), f.of)).collect::<Vec<_>>();
    let declared = declared.and_then(|at| hir.records.get(at)).filter(|r| types(&r.fields) == types(fields));
    declared.or_else(|| hir.records.iter().find(|record| pairs(&record.fields) == pairs(fields)))
}

fn structure(name: &Ident, line: &str, fields: &[Field]) -> TokenStream {
    let names: Vec<Ident> = fields.iter().map(|field| ident(&field.name)).collect();
    let types: Vec<Ident> = fields.iter().map(|field| format_ident!("{}", rust_type(field.of))).collect();
    let lines = fields.iter().map(|field| format!("`{}`.", field.name));
    let members: Vec<Member> = names.iter().cloned().map(Member::Named).collect();
    let message = implementation(name, &members, &types, true);
    quote! {
        #[doc = #line]
        #[allow(non_camel_case_types, dead_code)]
        #[derive(Clone, Copy, Debug, Default, PartialEq)]
        pub struct #name {
            #(#[doc = #lines] pub #names: #types,)*
        }
        #message
    }
}

const fn rust_type(of: Type) -> &'static str {
    match of {
        Type::Bool => "bool",
        Type::Int8 => "i8",
        Type::Int16 => "i16",
        Type::Int32 => "i32",
        Type::Word => "u32",
        Type::Real => "f32",
    }
}

/// A name of the cell as a Rust identifier: `type` becomes `r#type`. A name that cannot be a raw identifier gets a `_` at
/// its end.
fn ident(name: &str) -> Ident {
    let name = plain(name);
    let raw = || syn::parse_str::<Ident>(&format!("r#{name}"));
    let parsed = syn::parse_str::<Ident>(&name).or_else(|_| raw());
    parsed.unwrap_or_else(|_| Ident::new(&format!("{name}_"), Span::call_site()))
}

fn plain(name: &str) -> String {
    name.replace(|c: char| !c.is_ascii_alphanumeric(), "_")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_error_of_the_cell_is_said_with_code_line_and_help() {
        let said =
            items("tests/faulty.cell", include_bytes!("../tests/faulty.cell")).expect_err("a faulty cell");
        assert!(said.contains("error[E"), "{said}");
        assert!(said.contains("tests/faulty.cell:21:13"), "{said}");
        assert!(said.contains("help: "), "{said}");
        let said = items("x.cell", &[0xff, 0xfe]).expect_err("no text");
        assert!(said.contains("error["), "{said}");
    }

    #[test]
    fn a_cell_becomes_constants_records_and_types_of_its_ports() {
        let written =
            items("tests/vision.cell", include_bytes!("../tests/vision.cell")).expect("a sound cell");
        let written = written.to_string();
        for part in [
            "pub const POSE : :: imrs_runtime :: protocol :: PortId",
            "pub const CAMERA",
            "pub const HERE",
            "pub struct Pose",
            "pub type pose = super :: Pose",
            "pub type count = super :: count_message",
            "pub fn builder",
        ] {
            assert!(written.contains(part), "{part}: {written}");
        }
    }

    #[test]
    fn words_of_rust_are_names_nevertheless() {
        assert_eq!(ident("type").to_string(), "r#type");
        assert_eq!(ident("self").to_string(), "self_");
        assert_eq!(ident("p.x").to_string(), "p_x");
    }
}
