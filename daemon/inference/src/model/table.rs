//! The table of one model: keys that several kinds share, and those of its kind.

use std::num::NonZeroUsize;

use peernet_logger::Slug;
use serde::de::{self, DeserializeOwned, Visitor};
use serde::ser::{self, SerializeMap};
use serde::{Deserialize, Deserializer, Serialize, Serializer, forward_to_deserialize_any};
use serde_json::{Map, Value};

use super::ModelKind;

/// Keys with their values.
pub type Keys = Map<String, Value>;

/// The keys that several kinds share. A kind names those that it has ([`ModelKind::shared_keys`]); the others have their
/// defaults.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct SharedKeys {
    /// The name under which peers ask for it.
    pub name: Slug,
    /// What it runs on: of a model of kind `onnx` `cpu`, `cuda:0`, `tensorrt:0` or `openvino:CPU`, where the whole model runs
    /// or is refused. Code of the user's own finds it in the variable `PEERNET_DEVICE`. Default: `cpu`.
    #[serde(default = "cpu")]
    pub device: String,
    /// Threads that compute, each on a sample of its own; of code of the user's own, processes. Default: 1.
    #[serde(default = "one")]
    pub workers: NonZeroUsize,
    /// Samples that may wait for a free worker; more are refused. Default: 16.
    #[serde(default = "sixteen")]
    pub queue: NonZeroUsize,
}

fn cpu() -> String {
    "cpu".to_owned()
}

const fn one() -> NonZeroUsize {
    NonZeroUsize::MIN
}

const fn sixteen() -> NonZeroUsize {
    NonZeroUsize::MIN.saturating_add(15)
}

impl SharedKeys {
    /// A name, and the defaults.
    pub fn of(name: Slug) -> Self {
        Self { name, device: cpu(), workers: one(), queue: sixteen() }
    }

    /// The names of all of them.
    pub(super) fn names() -> &'static [&'static str] {
        field_names::<Self>()
    }
}

/// The table of one model.
///
/// In a file both groups of keys are one table. serde's `flatten` would read that as well, but no longer tell which keys there
/// are when one is misspelt; therefore the table is split here before each group is read.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ModelTable<K> {
    /// The keys that its kind shares with others.
    pub shared: SharedKeys,
    /// The keys of its kind.
    pub own: K,
}

impl<'de, K: ModelKind + DeserializeOwned> Deserialize<'de> for ModelTable<K> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let mut own = Keys::deserialize(deserializer)?;
        let known = [K::shared_keys(), field_names::<K>()].concat();
        if let Some(key) = own.keys().find(|key| !known.contains(&key.as_str())) {
            return Err(de::Error::custom(format!("unknown field `{key}`, expected {}", one_of(&known))));
        }
        let shared: Keys = K::shared_keys().iter().filter_map(|key| own.remove_entry(*key)).collect();
        let shared = serde_json::from_value(shared.into()).map_err(de::Error::custom)?;
        // Of a kind without keys serde reads `struct Name {}` from a map and `struct Name;` from null.
        let is_keyless = own.is_empty() && field_names::<K>().is_empty();
        let read = serde_json::from_value(own.into());
        let own = if is_keyless { read.or_else(|_| serde_json::from_value(Value::Null)) } else { read };
        Ok(Self { shared, own: own.map_err(de::Error::custom)? })
    }
}

impl<K: ModelKind + Serialize + DeserializeOwned> Serialize for ModelTable<K> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let keys = |group: serde_json::Result<Value>| match group.map_err(ser::Error::custom)? {
            Value::Object(keys) => Ok(keys),
            Value::Null => Ok(Keys::new()),
            _ => Err(ser::Error::custom("the keys of a model are no table")),
        };
        let mut own = keys(serde_json::to_value(&self.own))?;
        self.own.leave_out_defaults(&mut own);
        let mut table = keys(serde_json::to_value(&self.shared))?;
        table.extend(own);
        // In the order of their declaration, not of the alphabet.
        let mut map = serializer.serialize_map(None)?;
        for name in K::shared_keys().iter().chain(field_names::<K>()) {
            if let Some(value) = table.remove(*name) {
                map.serialize_entry(name, &value)?;
            }
        }
        map.end()
    }
}

/// The names of a struct's fields, as serde reads them.
fn field_names<T: DeserializeOwned>() -> &'static [&'static str] {
    let mut names: &[&str] = &[];
    // Reading ends with an error as soon as the names are there.
    let _ = T::deserialize(FieldNames(&mut names));
    names
}

/// Takes the names of the fields of the struct that is to be read.
struct FieldNames<'a>(&'a mut &'static [&'static str]);

impl<'de> Deserializer<'de> for FieldNames<'_> {
    type Error = de::value::Error;

    fn deserialize_struct<V: Visitor<'de>>(
        self,
        _name: &'static str,
        fields: &'static [&'static str],
        _visitor: V,
    ) -> Result<V::Value, Self::Error> {
        *self.0 = fields;
        Err(de::Error::custom("only the names are read"))
    }

    fn deserialize_any<V: Visitor<'de>>(self, _visitor: V) -> Result<V::Value, Self::Error> {
        Err(de::Error::custom("it is no struct"))
    }

    forward_to_deserialize_any! {
        bool i8 i16 i32 i64 i128 u8 u16 u32 u64 u128 f32 f64 char str string bytes byte_buf option unit unit_struct
        newtype_struct seq tuple tuple_struct map enum identifier ignored_any
    }
}

/// What serde says of the fields that it knows.
fn one_of(names: &[&str]) -> String {
    match names {
        [one] => format!("`{one}`"),
        [one, other] => format!("`{one}` or `{other}`"),
        _ => format!("one of `{}`", names.join("`, `")),
    }
}
