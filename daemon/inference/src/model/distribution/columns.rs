//! Columns of a `data.csv`. The sum of these columns in a row is one latency.

use std::collections::HashSet;
use std::fmt;

use peernet_logger::{Name, stage};
use serde::de::{Error, SeqAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize, Serializer};

/// Maximum number of columns.
const MAX_COLUMNS: usize = 64;
/// Stages that a remote pipeline measures itself. If the latencies contained these stages, they would count twice.
const TRANSPORT_STAGES: [Name; 3] = [stage::UPLOAD, stage::QUEUE, stage::DOWNLOAD];

/// One or more different columns of a `data.csv`. The configuration has one name or a list of names.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Columns(Vec<String>);

impl Columns {
    /// Returns the names.
    pub(super) fn names(&self) -> &[String] {
        &self.0
    }

    /// Returns whether one of the columns has this name.
    pub(super) fn contains(&self, name: &str) -> bool {
        self.0.iter().any(|column| column == name)
    }

    fn new(names: Vec<String>) -> Result<Self, String> {
        let mut seen = HashSet::new();
        if names.is_empty() {
            return Err("the list is empty; name a column of the data.csv".to_owned());
        }
        if names.len() > MAX_COLUMNS {
            return Err(format!("{} columns are too many; at most {MAX_COLUMNS}", names.len()));
        }
        if let Some(transport) =
            names.iter().find(|name| TRANSPORT_STAGES.iter().any(|stage| stage.as_str() == name.as_str()))
        {
            return Err(format!(
                "{transport} depends on the network and on the other users, and a remote pipeline with this model measures its own {transport}; \
                 name stages of the computation, such as inference"
            ));
        }
        match names.iter().find(|name| !seen.insert(name.as_str())) {
            Some(duplicate) => Err(format!("the list contains {duplicate} twice")),
            None => Ok(Self(names)),
        }
    }
}

impl Default for Columns {
    fn default() -> Self {
        Self(vec![stage::INFERENCE.to_string()])
    }
}

impl fmt::Display for Columns {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0.join(" + "))
    }
}

impl Serialize for Columns {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self.0.as_slice() {
            [column] => column.serialize(serializer),
            columns => columns.serialize(serializer),
        }
    }
}

impl<'de> Deserialize<'de> for Columns {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(ColumnsVisitor)
    }
}

/// Visitor that reads a name or a list of names.
// An untagged enum would be shorter, but its error would not say what is wrong.
struct ColumnsVisitor;

impl<'de> Visitor<'de> for ColumnsVisitor {
    type Value = Columns;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("the name of a column or a list of names")
    }

    fn visit_str<E: Error>(self, text: &str) -> Result<Columns, E> {
        Columns::new(vec![text.to_owned()]).map_err(E::custom)
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<Columns, A::Error> {
        let mut names = Vec::new();
        while let Some(name) = list.next_element()? {
            names.push(name);
        }
        Columns::new(names).map_err(A::Error::custom)
    }
}

#[cfg(test)]
mod tests {
    use serde_json::{from_value, json, to_value};

    use super::*;

    #[test]
    fn columns_read_back_as_written() {
        for written in [json!("inference"), json!(["preprocessing", "inference"])] {
            let read: Columns = from_value(written.clone()).expect("columns");
            assert_eq!(to_value(&read).expect("writes"), written);
        }
        assert_eq!(to_value(from_value::<Columns>(json!(["total"])).expect("one")).expect("writes"), "total");
    }

    #[test]
    fn wrong_columns_are_refused_with_reason() {
        let many: Vec<String> = (0..65).map(|number| number.to_string()).collect();
        for (written, reason) in [
            (json!([]), "the list is empty"),
            (json!(["inference", "total", "inference"]), "the list contains inference twice"),
            (json!(many), "65 columns are too many; at most 64"),
            (json!("upload"), "upload depends on the network"),
            (json!(["inference", "queue"]), "queue depends on the network and on the other users"),
            (json!(7), "expected the name of a column or a list of names"),
        ] {
            let error = from_value::<Columns>(written).expect_err(reason).to_string();
            assert!(error.contains(reason), "{error}");
        }
    }
}
