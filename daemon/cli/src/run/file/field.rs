//! Paths of fields in a document: `pipeline.transforms[0].width`.

use std::fmt;

use toml::{Table, Value};

use crate::renamed_tables::replace_former_name;

/// Path of a field.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(in crate::run) struct Field(Vec<Step>);

/// One step of the path.
#[derive(Clone, Debug, PartialEq, Eq)]
enum Step {
    Key(String),
    Index(usize),
}

/// An invalid path, or one that does not exist.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub(in crate::run) enum FieldError {
    #[error("{0:?} is not the path of a field; write it as pipeline.placement.model")]
    Path(String),
    #[error("{path:?} is not the path of a field: {index:?} is not an index of a list; indices start at 0")]
    Index { path: String, index: String },
    #[error("there is no {field}: {list} has {count} entries, and indices start at 0")]
    NoEntry { field: Field, list: Field, count: usize },
    #[error("there is no {field}: {parent} is not a table")]
    NoTable { field: Field, parent: Field },
    #[error("there is no {field}: {parent} is not a list")]
    NoList { field: Field, parent: Field },
}

impl Field {
    /// Reads a path.
    ///
    /// # Errors
    /// When the text is no path.
    pub(super) fn read(text: &str) -> Result<Self, FieldError> {
        let mut steps = Vec::new();
        for part in text.split('.') {
            let (key, indices) = part.split_at(part.find('[').unwrap_or(part.len()));
            if key.is_empty() || key.contains(char::is_control) {
                return Err(FieldError::Path(text.to_owned()));
            }
            // Files of earlier releases use the earlier names of tables; only the first key is a table's name.
            let key = if steps.is_empty() { replace_former_name(key) } else { key };
            steps.push(Step::Key(key.to_owned()));
            for index in indices.split_terminator(']') {
                let number = index.strip_prefix('[').and_then(|number| number.parse().ok());
                let number = number
                    .ok_or_else(|| FieldError::Index { path: text.to_owned(), index: format!("{index}]") })?;
                steps.push(Step::Index(number));
            }
        }
        Ok(Self(steps))
    }

    /// Returns the first key, which is the name of a table.
    pub(super) fn table(&self) -> &str {
        match self.0.first() {
            Some(Step::Key(key)) => key,
            _ => "",
        }
    }

    /// Returns the last key.
    pub(super) fn key(&self) -> &str {
        let last = self.0.iter().rev().find_map(|step| match step {
            Step::Key(key) => Some(key.as_str()),
            Step::Index(_) => None,
        });
        last.unwrap_or_default()
    }

    /// Returns whether one of the two paths is a prefix of the other.
    pub(super) fn overlaps(&self, other: &Self) -> bool {
        self.0.iter().zip(&other.0).all(|(a, b)| a == b)
    }

    /// Returns whether setting this field overwrites the other field, either directly or because this field contains
    /// it.
    pub(super) fn covers(&self, other: &Self) -> bool {
        self.0.len() <= other.0.len() && self.overlaps(other)
    }

    /// Sets the field to a value and creates missing tables on the way.
    ///
    /// # Errors
    /// When the path does not exist.
    pub(super) fn set(&self, document: &mut Table, value: Value) -> Result<(), FieldError> {
        let Some((Step::Key(first), rest)) = self.0.split_first() else { return Ok(()) };
        if rest.is_empty() {
            document.insert(first.clone(), value);
            return Ok(());
        }
        let mut current_value = document.entry(first.clone()).or_insert_with(|| Value::Table(Table::new()));
        for (index, step) in rest.iter().enumerate() {
            let path_so_far = || Self(self.0[..=index].to_vec());
            current_value = match (step, current_value) {
                (Step::Key(key), Value::Table(table)) => {
                    table.entry(key.clone()).or_insert_with(|| Value::Table(Table::new()))
                }
                // Lists are not extended: an index beyond the end is a mistake, because the entries between would be
                // undefined.
                (Step::Index(index), Value::Array(list)) => {
                    let count = list.len();
                    let no_entry = || FieldError::NoEntry { field: self.clone(), list: path_so_far(), count };
                    list.get_mut(*index).ok_or_else(no_entry)?
                }
                (Step::Key(_), _) => {
                    return Err(FieldError::NoTable { field: self.clone(), parent: path_so_far() });
                }
                (Step::Index(_), _) => {
                    return Err(FieldError::NoList { field: self.clone(), parent: path_so_far() });
                }
            };
        }
        *current_value = value;
        Ok(())
    }
}

impl fmt::Display for Field {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (index, step) in self.0.iter().enumerate() {
            match step {
                Step::Key(key) if index == 0 => f.write_str(key)?,
                Step::Key(key) => write!(f, ".{key}")?,
                Step::Index(index) => write!(f, "[{index}]")?,
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn set(path: &str, document: &str) -> Result<String, FieldError> {
        let mut document: Table = document.parse().expect("TOML");
        Field::read(path)?.set(&mut document, Value::Integer(7))?;
        Ok(document.to_string().split_whitespace().collect::<Vec<_>>().join(" "))
    }

    #[test]
    fn value_is_set_at_path() {
        assert_eq!(set("a.b", "a = { c = 1 }").as_deref(), Ok("[a] b = 7 c = 1"));
        assert_eq!(set("a.b.c", "").as_deref(), Ok("[a.b] c = 7"));
        assert_eq!(set("a[1].b", "a = [{ b = 1 }, { b = 2 }]").as_deref(), Ok("[[a]] b = 1 [[a]] b = 7"));
        assert_eq!(set("a[0]", "a = [1, 2]").as_deref(), Ok("a = [7, 2]"));
    }

    #[test]
    fn unknown_path_is_reported() {
        for (path, document, message) in [
            ("a..b", "", "not the path"),
            ("a\nb", "", "not the path"),
            ("a[x]", "", "not an index of a list"),
            ("a[2].b", "a = [1]", "there is no a[2].b: a has 1 entries"),
            ("a.b.c", "a = { b = 1 }", "a.b is not a table"),
            ("a[0]", "a = { b = 1 }", "a is not a list"),
        ] {
            let error = set(path, document).expect_err(path);
            assert!(error.to_string().contains(message), "{error}");
        }
    }

    #[test]
    fn fields_overlap_if_one_contains_the_other() {
        let field = |text| Field::read(text).expect("a path");
        assert!(field("a.b").overlaps(&field("a.b.c")) && field("a.b.c").overlaps(&field("a.b")));
        assert!(!field("a.b").overlaps(&field("a.c")) && !field("a[0]").overlaps(&field("a[1]")));
        assert!(field("a.b").covers(&field("a.b.c")) && !field("a.b.c").covers(&field("a.b")));
        assert_eq!((field("a.b[1]").table(), field("a.b[1]").key()), ("a", "b"));
    }
}
