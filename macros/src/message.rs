//! `derive(Message)`: the implementation of `Message` for a struct.

use proc_macro2::TokenStream;
use quote::{ToTokens, quote};
use syn::{Data, DeriveInput, Error, Field, Fields, Ident, Member, Type};

/// The implementation of `Message` for a struct.
///
/// # Errors
/// If the input is an enum, a union, or a struct with parameters.
pub fn expand(input: &DeriveInput) -> syn::Result<TokenStream> {
    let Data::Struct(data) = &input.data else {
        return Err(Error::new_spanned(
            &input.ident,
            "a message is a struct: the cell language has no variants",
        ));
    };
    if !input.generics.params.is_empty() {
        return Err(Error::new_spanned(&input.generics, "a message has one layout: no parameters"));
    }
    let member = |(at, field): (usize, &Field)| field.ident.clone().map_or_else(|| at.into(), Member::Named);
    let members: Vec<Member> = data.fields.iter().enumerate().map(member).collect();
    let types: Vec<&Type> = data.fields.iter().map(|field| &field.ty).collect();
    let named = !matches!(data.fields, Fields::Unit);
    Ok(implementation(&input.ident, &members, &types, named))
}

/// The implementation for the struct `name` with these fields.
pub fn implementation<T: ToTokens>(
    name: &Ident,
    members: &[Member],
    types: &[T],
    named: bool,
) -> TokenStream {
    let field = quote!(::imrs_runtime::message::Field);
    let longest = quote!(::imrs_runtime::message::LONGEST);
    let value = if named { quote!(Self { #(#members,)* }) } else { quote!(Self) };
    // The members of a tuple struct are numbers, so the decoded values need names of their own.
    let locals: Vec<Ident> = (0..members.len()).map(|at| quote::format_ident!("field_{at}")).collect();
    let read = if named { quote!(Self { #(#members: #locals,)* }) } else { value };
    quote! {
        impl ::imrs_runtime::Message for #name {
            const SIZE: usize = {
                let size = 0 #(+ <#types as #field>::BYTES)*;
                assert!(size <= #longest, "a message has at most 192 bytes");
                size
            };

            #[allow(unused_variables, unused_mut, unused_assignments)]
            fn encode(&self, out: &mut [u8; #longest]) -> ::core::option::Option<usize> {
                let mut at = 0;
                #(
                    #field::put(self.#members, out.get_mut(at..at + <#types as #field>::BYTES)?)?;
                    at += <#types as #field>::BYTES;
                )*
                ::core::option::Option::Some(Self::SIZE)
            }

            #[allow(unused_variables, unused_mut, unused_assignments)]
            fn decode(bytes: &[u8]) -> ::core::option::Option<Self> {
                if bytes.len() != Self::SIZE {
                    return ::core::option::Option::None;
                }
                let mut rest = bytes;
                #(
                    let (first, after) = rest.split_at_checked(<#types as #field>::BYTES)?;
                    let #locals = <#types as #field>::take(first)?;
                    rest = after;
                )*
                ::core::option::Option::Some(#read)
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_a_struct_without_parameters_is_a_message() {
        let said =
            |text: &str| expand(&syn::parse_str(text).expect("Rust")).map_err(|error| error.to_string());
        assert!(said("struct Pose { x: i16 }").is_ok());
        assert!(said("struct Pair(i8, bool);").is_ok() && said("struct Nothing;").is_ok());
        assert!(said("enum E { A }").expect_err("an enum").contains("no variants"));
        assert!(said("struct P<T> { x: T }").expect_err("a parameter").contains("one layout"));
    }
}
