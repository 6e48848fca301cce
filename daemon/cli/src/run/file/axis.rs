//! `[[axis]]`: one dimension of the matrix.

use std::collections::BTreeMap;

use peernet_analysis::compare::Comparison;
use peernet_analysis::users::Users;
use peernet_external::exec::CommandLine;
use serde::Deserialize;
use toml::Value;

use super::field::{Field, FieldError};

/// Tables whose fields an axis may change.
const VARIABLE_TABLES: [&str; 10] = [
    "experiment",
    "network",
    "pipeline",
    "model",
    "bank",
    "agent",
    "clock",
    "probes",
    "clock_fault",
    "onnxruntime",
];
/// Keys of `[experiment]` that may differ between configurations.
const VARIABLE_KEYS: [&str; 7] =
    ["episodes", "episode_steps", "warm_up", "iterations", "duration_s", "users", "patience_s"];

/// Columns that a comparison adds to the axes if the axes do not distinguish the runs.
const ADDED_COLUMNS: [&str; 3] = ["run", "repeat", "repeats"];

/// `[[axis]]` as in the file.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct AxisTable {
    name: String,
    #[serde(default)]
    field: Option<String>,
    #[serde(default)]
    values: Vec<Value>,
    #[serde(default)]
    value: Vec<ValueTable>,
}

/// `[[axis.value]]`
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct ValueTable {
    label: Value,
    #[serde(default)]
    set: BTreeMap<String, Value>,
}

/// One dimension of the matrix.
#[derive(Clone, Debug)]
pub(in crate::run) struct Axis {
    /// Name in tables.
    pub(in crate::run) name: String,
    /// Possible values.
    pub(in crate::run) values: Vec<AxisValue>,
}

/// One value of an axis.
#[derive(Clone, Debug)]
pub(in crate::run) struct AxisValue {
    /// Name in tables.
    pub(in crate::run) label: String,
    /// Fields of the document that it sets, with their values.
    pub(super) sets: Vec<(Field, Value)>,
}

/// An invalid table of an axis.
#[derive(Debug, thiserror::Error)]
pub(super) enum AxisError {
    #[error("give either field = \"…\" and values = […], or [[axis.value]] with label and set")]
    Form,
    #[error("name: {0:?} contains a control character, which would break tables")]
    NameControl(String),
    #[error("name: tables of results already have a column named {0}; choose another name")]
    NameColumn(String),
    #[error(
        "the label {0:?} contains a control character, which would break tables; set another label with [[axis.value]]"
    )]
    LabelControl(String),
    #[error(
        "two values are labelled {0}; tables could not tell them apart: give them labels with [[axis.value]]"
    )]
    SameLabel(String),
    #[error("{0} has no text for tables; use [[axis.value]] with a label")]
    NoLabel(Value),
    #[error("the label must be a text, a number or a boolean")]
    LabelType,
    #[error(transparent)]
    Field(#[from] FieldError),
    #[error("there is no field {0}: a path begins with {tables}, such as pipeline.placement.model", tables = VARIABLE_TABLES.join(", "))]
    UnknownTable(String),
    #[error(
        "{0} cannot be the field of an axis, because it applies to all runs; of [experiment] only {keys} can",
        keys = VARIABLE_KEYS.join(", ")
    )]
    SameForAll(String),
}

impl Axis {
    /// Reads an axis.
    ///
    /// # Errors
    /// When the table is invalid.
    pub(super) fn read(table: AxisTable) -> Result<Self, AxisError> {
        let AxisTable { name, field, values, value } = table;
        let values: Vec<AxisValue> = match (field, values.is_empty(), value.is_empty()) {
            (Some(field), false, true) => read_short_form(&field, values)?,
            (None, true, false) => value.into_iter().map(read_long_form).collect::<Result<_, _>>()?,
            _ => return Err(AxisError::Form),
        };
        // Names and labels are printed in tables and in lines of the terminal.
        if name.contains(char::is_control) {
            return Err(AxisError::NameControl(name));
        }
        let mut columns = Users::CSV_COLUMNS.into_iter().chain(ADDED_COLUMNS);
        if Comparison::csv_columns().contains(&name) || columns.any(|column| column == name) {
            return Err(AxisError::NameColumn(name));
        }
        if let Some(value) = values.iter().find(|value| value.label.contains(char::is_control)) {
            return Err(AxisError::LabelControl(value.label.clone()));
        }
        let axis = Self { name, values };
        let labels: Vec<&str> = axis.values.iter().map(|value| value.label.as_str()).collect();
        match labels.iter().enumerate().find(|(index, label)| labels[..*index].contains(label)) {
            Some((_, label)) => Err(AxisError::SameLabel((*label).to_owned())),
            None => Ok(axis),
        }
    }

    /// Returns whether this axis overwrites a field that an earlier axis sets.
    pub(super) fn overwrites(&self, earlier: &Self) -> bool {
        // This axis may set a part of what the earlier axis sets, but not replace the whole, which
        // would make the earlier axis ineffective.
        self.fields().any(|field| earlier.fields().any(|earlier_field| field.covers(earlier_field)))
    }

    /// Returns whether this axis overwrites the field in every run.
    pub(super) fn always_covers(&self, field: &Field) -> bool {
        self.values.iter().all(|value| value.sets.iter().any(|(set, _)| set.covers(field)))
    }

    fn fields(&self) -> impl Iterator<Item = &Field> {
        self.values.iter().flat_map(|value| &value.sets).map(|(field, _)| field)
    }

    /// Returns the labels, separated by commas, for messages.
    pub(super) fn list_labels(&self) -> String {
        self.values.iter().map(|value| value.label.as_str()).collect::<Vec<_>>().join(", ")
    }
}

/// Reads `field` and `values`: one field, with the values as labels.
fn read_short_form(field: &str, values: Vec<Value>) -> Result<Vec<AxisValue>, AxisError> {
    // The arguments of a program may be secret, and labels are sent to aggregators. The label of a command is therefore
    // only its program.
    let is_command = field.ends_with(".command");
    let field = variable_field(field)?;
    let value = |value: Value| {
        let label = match value.clone().try_into::<CommandLine>() {
            Ok(command) if is_command => Some(command.to_string()),
            _ => label(&value),
        };
        let label = label.ok_or_else(|| AxisError::NoLabel(value.clone()))?;
        Ok(AxisValue { label, sets: vec![(field.clone(), value)] })
    };
    values.into_iter().map(value).collect()
}

/// Reads `[[axis.value]]`: any number of fields.
fn read_long_form(value: ValueTable) -> Result<AxisValue, AxisError> {
    let label = label(&value.label).ok_or(AxisError::LabelType)?;
    let sets = value.set.into_iter().map(|(field, value)| Ok((variable_field(&field)?, value)));
    Ok(AxisValue { label, sets: sets.collect::<Result<_, AxisError>>()? })
}

/// Reads a field that an axis may change.
fn variable_field(text: &str) -> Result<Field, AxisError> {
    let field = Field::read(text)?;
    if !VARIABLE_TABLES.contains(&field.table()) {
        return Err(AxisError::UnknownTable(text.to_owned()));
    }
    // Most keys of `[experiment]` apply to all runs together. All keys of other tables may vary.
    let experiment_key = text.strip_prefix("experiment.").map(|rest| rest.split('.').next().unwrap_or(rest));
    if field.table() == "experiment" && !experiment_key.is_some_and(|key| VARIABLE_KEYS.contains(&key)) {
        return Err(AxisError::SameForAll(text.to_owned()));
    }
    Ok(field)
}

/// Returns the label of a value: its text, unless it is a list, a table or a date.
pub(super) fn label(value: &Value) -> Option<String> {
    match value {
        Value::String(text) => Some(text.clone()),
        Value::Integer(number) => Some(number.to_string()),
        Value::Float(number) => Some(number.to_string()),
        Value::Boolean(true) => Some("yes".to_owned()),
        Value::Boolean(false) => Some("no".to_owned()),
        // These values have no short text for a column. `[[axis.value]]` gives them a label.
        Value::Datetime(_) | Value::Array(_) | Value::Table(_) => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<Axis, AxisError> {
        Axis::read(toml::from_str(text).expect("it is a table of [[axis]]"))
    }

    #[test]
    fn both_forms_are_read() {
        let short = read("name = 'Size'\nfield = 'pipeline.sensor.size_bytes'\nvalues = [1, 2.5, 'x', true]");
        let labels = |axis: &Axis| axis.values.iter().map(|value| value.label.clone()).collect::<Vec<_>>();
        assert_eq!(labels(&short.expect("reads")), ["1", "2.5", "x", "yes"]);
        let long = read(
            "name = 'Resize'\n[[value]]\nlabel = false\n[[value]]\nlabel = 'yes'\n\
             set = { 'pipeline.transforms' = [], 'experiment.users' = 2 }",
        )
        .expect("reads");
        assert_eq!((labels(&long), long.values[1].sets.len()), (vec!["no".into(), "yes".into()], 2));
    }

    #[test]
    fn list_overwrites_its_entry_but_not_conversely() {
        let axis = |name: &str, field: &str| {
            read(&format!("name = '{name}'\nfield = '{field}'\nvalues = [1]")).expect("reads")
        };
        let list = axis("Resize", "pipeline.transforms");
        let entry = axis("Width", "pipeline.transforms[0].width");
        assert!(list.overwrites(&entry) && !entry.overwrites(&list));
    }

    #[test]
    fn invalid_axes_are_refused_with_the_reason() {
        for (text, message) in [
            ("name = 'a'", "either field"),
            ("name = 'a'\nfield = 'pipeline.x'\nvalues = [1]\n[[value]]\nlabel = 'b'", "either field"),
            ("name = 'a'\nfield = 'pipelin.x'\nvalues = [1]", "there is no field pipelin.x"),
            ("name = 'a'\nfield = 'experiment.seed'\nvalues = [1]", "it applies to all runs"),
            ("name = 'a'\nfield = 'pipeline.load'\nvalues = [{ mode = 'closed' }]", "has no text for tables"),
            ("name = 'a'\nfield = 'pipeline.x'\nvalues = [1, 1]", "labelled 1"),
            (
                "name = 'a'\nfield = 'pipeline.x'\nvalues = [\"b\\nc\"]",
                r#"the label "b\nc" contains a control"#,
            ),
            ("name = \"a\\u001b\"\nfield = 'pipeline.x'\nvalues = [1]", "name: "),
            ("name = 'superseded'\nfield = 'pipeline.x'\nvalues = [1]", "a column named superseded"),
            ("name = 'rate'\nfield = 'pipeline.x'\nvalues = [1]", "a column named rate"),
            ("name = 'run'\nfield = 'pipeline.x'\nvalues = [1]", "a column named run"),
        ] {
            let error = read(text).expect_err(text);
            assert!(error.to_string().contains(message), "{error}");
        }
    }
}
