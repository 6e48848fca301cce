//! The table of one model: the settings that several kinds of model have, and the settings that only the kind of this
//! model has.

use std::num::NonZeroUsize;

use peernet_logger::Slug;
use serde::de::{self, DeserializeOwned, Visitor};
use serde::ser::{self, SerializeMap};
use serde::{Deserialize, Deserializer, Serialize, Serializer, forward_to_deserialize_any};
use serde_json::{Map, Value};

use super::ModelKind;

/// Keys of a table with their values.
pub type Keys = Map<String, Value>;

/// Settings that several kinds of model have. A kind lists the keys that it has ([`ModelKind::common_keys`]); the other
/// settings have their defaults.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct CommonSettings {
    /// Name under which peers request the model.
    pub name: Slug,
    /// Device on which the model runs. For kind `onnx`: `cpu`, `cuda:0`, `tensorrt:0` or `openvino:CPU`; if a part of
    /// the model cannot run on this device, loading fails. Custom code finds the device in the environment variable
    /// `PEERNET_DEVICE`. Default: [`ModelKind::default_device`].
    #[serde(default = "default_device")]
    pub device: String,
    /// Number of worker threads, each of which computes one sample at a time; for custom code, also the number of
    /// processes. Default: 1.
    #[serde(default = "default_workers")]
    pub workers: NonZeroUsize,
    /// Maximum number of samples that wait for a free worker; further samples are rejected. Default: 16.
    #[serde(default = "default_queue")]
    pub queue: NonZeroUsize,
}

fn default_device() -> String {
    CommonSettings::DEFAULT_DEVICE.to_owned()
}

const fn default_workers() -> NonZeroUsize {
    NonZeroUsize::MIN
}

const fn default_queue() -> NonZeroUsize {
    NonZeroUsize::MIN.saturating_add(15)
}

impl CommonSettings {
    /// Default device of kinds that compute on this host.
    pub(super) const DEFAULT_DEVICE: &str = "cpu";

    /// Returns settings with this name and with the defaults of all other keys.
    pub fn new(name: Slug) -> Self {
        Self { name, device: default_device(), workers: default_workers(), queue: default_queue() }
    }

    /// Returns the keys of all common settings.
    pub(super) fn keys() -> &'static [&'static str] {
        field_names::<Self>()
    }
}

/// Table of one model.
///
/// In a file, both groups of keys form one table. serde's `flatten` could read such a table, but its error about a
/// misspelt key would not list the known keys. Therefore the table is split here, and then each group is read.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ModelTable<K> {
    /// Settings that other kinds have, too.
    pub common: CommonSettings,
    /// Settings that only this kind has.
    pub kind_settings: K,
}

impl<'de, K: ModelKind + DeserializeOwned> Deserialize<'de> for ModelTable<K> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let mut entries = Keys::deserialize(deserializer)?;
        let known_keys = [K::common_keys(), field_names::<K>()].concat();
        if let Some(key) = entries.keys().find(|key| !known_keys.contains(&key.as_str())) {
            return Err(de::Error::custom(format!(
                "unknown field `{key}`, expected {}",
                one_of(&known_keys)
            )));
        }
        // NaN and infinity in TOML have become null, because JSON has no such numbers.
        if let Some((key, _)) = entries.iter().find(|(_, value)| value.is_null()) {
            return Err(de::Error::custom(format!("`{key}` is nan or inf; write a finite number")));
        }
        let mut common: Keys = K::common_keys().iter().filter_map(|key| entries.remove_entry(*key)).collect();
        common.entry("device").or_insert_with(|| K::default_device().into());
        let common = serde_json::from_value(common.into()).map_err(de::Error::custom)?;
        // The remaining entries are the keys of the kind. For a kind without keys, serde reads `struct Name {}` from a
        // map and `struct Name;` from null.
        let is_keyless = entries.is_empty() && field_names::<K>().is_empty();
        let read = serde_json::from_value(entries.into());
        let kind_settings =
            if is_keyless { read.or_else(|_| serde_json::from_value(Value::Null)) } else { read };
        Ok(Self { common, kind_settings: kind_settings.map_err(de::Error::custom)? })
    }
}

impl<K: ModelKind + Serialize + DeserializeOwned> Serialize for ModelTable<K> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let keys = |group: serde_json::Result<Value>| match group.map_err(ser::Error::custom)? {
            Value::Object(keys) => Ok(keys),
            Value::Null => Ok(Keys::new()),
            _ => Err(ser::Error::custom("the keys of a model are not a table")),
        };
        let mut kind_settings = keys(serde_json::to_value(&self.kind_settings))?;
        self.kind_settings.remove_defaults(&mut kind_settings);
        let mut table = keys(serde_json::to_value(&self.common))?;
        table.extend(kind_settings);
        // The keys are written in the order of their declaration, not in alphabetical order.
        let mut map = serializer.serialize_map(None)?;
        for name in K::common_keys().iter().chain(field_names::<K>()) {
            if let Some(value) = table.remove(*name) {
                map.serialize_entry(name, &value)?;
            }
        }
        map.end()
    }
}

/// Returns the names of a struct's fields under which serde reads the fields.
fn field_names<T: DeserializeOwned>() -> &'static [&'static str] {
    let mut names: &[&str] = &[];
    // Deserialization ends with an error as soon as the names are known.
    let _ = T::deserialize(FieldNames(&mut names));
    names
}

/// Deserializer that stores the field names of the struct that is to be read.
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
        Err(de::Error::custom("the type is not a struct"))
    }

    forward_to_deserialize_any! {
        bool i8 i16 i32 i64 i128 u8 u16 u32 u64 u128 f32 f64 char str string bytes byte_buf option unit unit_struct
        newtype_struct seq tuple tuple_struct map enum identifier ignored_any
    }
}

/// Formats a list of known fields as serde does.
fn one_of(names: &[&str]) -> String {
    match names {
        [name] => format!("`{name}`"),
        [first, second] => format!("`{first}` or `{second}`"),
        _ => format!("one of `{}`", names.join("`, `")),
    }
}
