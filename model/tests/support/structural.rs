//! Hashes a value by visiting its fields as serde does, like a derived `Hash`: nothing is packed or allocated. Fields that
//! cannot affect later behaviour are left out by name.

use serde::ser::{self, Serialize};
use std::fmt;
use std::hash::Hasher;

/// The names of fields without effect on behaviour: counters, numbers of arrival, the bookkeeping of a queue, and
/// observations. In these worlds `incarnation` is constant, because no node restarts. No task has two ports, so no GET can
/// bypass a port (`served`, `since`), and no task reads the values that others brought to a meeting (`told`).
const LEFT_OUT: [&str; 12] = [
    "counters",
    "arrivals",
    "arrival",
    "places",
    "groups",
    "free",
    "confirmed",
    "incarnation",
    "taken",
    "served",
    "since",
    "told",
];

/// Feeds the fields of `value` to the hasher.
pub fn hash_fields(value: &impl Serialize, hasher: &mut impl Hasher) {
    value.serialize(&mut Fields(hasher)).expect("hashing takes every value");
}

struct Fields<'a, H>(&'a mut H);

macro_rules! integers {
    ($($method:ident $type:ty, $write:ident);*) => {
        $(fn $method(self, value: $type) -> Result<(), fmt::Error> {
            self.0.$write(value);
            Ok(())
        })*
    };
}

impl<H: Hasher> ser::Serializer for &mut Fields<'_, H> {
    type Ok = ();
    type Error = fmt::Error;
    type SerializeSeq = Self;
    type SerializeTuple = Self;
    type SerializeTupleStruct = Self;
    type SerializeTupleVariant = Self;
    type SerializeMap = Self;
    type SerializeStruct = Self;
    type SerializeStructVariant = Self;

    integers! {
        serialize_u8 u8, write_u8; serialize_u16 u16, write_u16; serialize_u32 u32, write_u32;
        serialize_u64 u64, write_u64; serialize_u128 u128, write_u128; serialize_i8 i8, write_i8;
        serialize_i16 i16, write_i16; serialize_i32 i32, write_i32; serialize_i64 i64, write_i64
    }
    fn serialize_bool(self, value: bool) -> Result<(), fmt::Error> {
        self.serialize_u8(u8::from(value))
    }
    fn serialize_f32(self, value: f32) -> Result<(), fmt::Error> {
        self.serialize_u32(value.to_bits())
    }
    fn serialize_f64(self, value: f64) -> Result<(), fmt::Error> {
        self.serialize_u64(value.to_bits())
    }
    fn serialize_char(self, value: char) -> Result<(), fmt::Error> {
        self.serialize_u32(value.into())
    }
    fn serialize_str(self, value: &str) -> Result<(), fmt::Error> {
        self.serialize_bytes(value.as_bytes())
    }
    fn serialize_bytes(self, value: &[u8]) -> Result<(), fmt::Error> {
        self.0.write_usize(value.len());
        self.0.write(value);
        Ok(())
    }
    fn serialize_none(self) -> Result<(), fmt::Error> {
        self.serialize_u8(0)
    }
    fn serialize_some<T: Serialize + ?Sized>(self, value: &T) -> Result<(), fmt::Error> {
        self.0.write_u8(1);
        value.serialize(self)
    }
    fn serialize_unit(self) -> Result<(), fmt::Error> {
        Ok(())
    }
    fn serialize_unit_struct(self, _: &'static str) -> Result<(), fmt::Error> {
        Ok(())
    }
    fn serialize_unit_variant(self, _: &'static str, at: u32, _: &'static str) -> Result<(), fmt::Error> {
        self.serialize_u32(at)
    }
    fn serialize_newtype_struct<T: Serialize + ?Sized>(
        self,
        _: &'static str,
        value: &T,
    ) -> Result<(), fmt::Error> {
        value.serialize(self)
    }
    fn serialize_newtype_variant<T: Serialize + ?Sized>(
        self,
        _: &'static str,
        at: u32,
        _: &'static str,
        value: &T,
    ) -> Result<(), fmt::Error> {
        self.0.write_u32(at);
        value.serialize(self)
    }
    fn serialize_seq(self, len: Option<usize>) -> Result<Self, fmt::Error> {
        self.0.write_usize(len.unwrap_or(usize::MAX));
        Ok(self)
    }
    fn serialize_tuple(self, _: usize) -> Result<Self, fmt::Error> {
        Ok(self)
    }
    fn serialize_tuple_struct(self, _: &'static str, _: usize) -> Result<Self, fmt::Error> {
        Ok(self)
    }
    fn serialize_tuple_variant(
        self,
        _: &'static str,
        at: u32,
        _: &'static str,
        _: usize,
    ) -> Result<Self, fmt::Error> {
        self.0.write_u32(at);
        Ok(self)
    }
    fn serialize_map(self, len: Option<usize>) -> Result<Self, fmt::Error> {
        self.serialize_seq(len)
    }
    fn serialize_struct(self, _: &'static str, _: usize) -> Result<Self, fmt::Error> {
        Ok(self)
    }
    fn serialize_struct_variant(
        self,
        _: &'static str,
        at: u32,
        _: &'static str,
        _: usize,
    ) -> Result<Self, fmt::Error> {
        self.0.write_u32(at);
        Ok(self)
    }
}

macro_rules! elements {
    ($($trait:ident $method:ident),*) => {
        $(impl<H: Hasher> ser::$trait for &mut Fields<'_, H> {
            type Ok = ();
            type Error = fmt::Error;
            fn $method<T: Serialize + ?Sized>(&mut self, value: &T) -> Result<(), fmt::Error> {
                value.serialize(&mut **self)
            }
            fn end(self) -> Result<(), fmt::Error> {
                Ok(())
            }
        })*
    };
}

elements! {
    SerializeSeq serialize_element, SerializeTuple serialize_element, SerializeTupleStruct serialize_field,
    SerializeTupleVariant serialize_field
}

macro_rules! named {
    ($($trait:ident),*) => {
        $(impl<H: Hasher> ser::$trait for &mut Fields<'_, H> {
            type Ok = ();
            type Error = fmt::Error;
            fn serialize_field<T: Serialize + ?Sized>(
                &mut self,
                name: &'static str,
                value: &T,
            ) -> Result<(), fmt::Error> {
                if LEFT_OUT.contains(&name) { Ok(()) } else { value.serialize(&mut **self) }
            }
            fn end(self) -> Result<(), fmt::Error> {
                Ok(())
            }
        })*
    };
}

named! { SerializeStruct, SerializeStructVariant }

impl<H: Hasher> ser::SerializeMap for &mut Fields<'_, H> {
    type Ok = ();
    type Error = fmt::Error;
    fn serialize_key<T: Serialize + ?Sized>(&mut self, key: &T) -> Result<(), fmt::Error> {
        key.serialize(&mut **self)
    }
    fn serialize_value<T: Serialize + ?Sized>(&mut self, value: &T) -> Result<(), fmt::Error> {
        value.serialize(&mut **self)
    }
    fn end(self) -> Result<(), fmt::Error> {
        Ok(())
    }
}
