//! Finds all mistakes in a configuration file that cannot be deserialised. Mistakes are unknown keys, values of the
//! wrong type, and missing keys.

use std::borrow::Cow;
use std::collections::{BTreeMap, BTreeSet};
use std::fmt;

use serde::Deserialize;
use serde::de::Error as _;
use serde_path_to_error::{Path, Segment};
use toml::Spanned;
use toml::de::{DeArray, DeTable, DeValue, Deserializer, Error};

/// Maximum number of mistakes that are reported for one file.
const MAX_MISTAKES: usize = 100;
/// Beginning of serde's message about a missing key.
// serde reports a missing key as text only.
const MISSING_KEY_PREFIX: &str = "missing field";
/// Beginning of serde's message about an unknown key.
const UNKNOWN_KEY_PREFIX: &str = "unknown field";

/// A key that cannot be deserialised, with the error.
#[derive(Debug)]
pub(super) struct Mistake {
    /// Path of the key; empty for the whole file.
    pub(super) key: String,
    pub(super) error: Error,
}

/// The file without the keys that have mistakes, and without the tables that cannot be read without these keys.
pub(super) struct Remainder<T> {
    pub(super) file: T,
    /// Names of all tables with mistakes, including removed tables.
    pub(super) tables_with_mistakes: BTreeSet<String>,
    /// Paths of the removed keys.
    removed_keys: Vec<String>,
    /// For each array of tables, the indices that the remaining elements have in the file.
    indices_in_file: BTreeMap<String, Vec<usize>>,
}

/// Reads a file. Of its top-level keys, only those in `arrays` are arrays of tables.
///
/// # Errors
/// The first key that could not be read.
pub(super) fn read<'a, T: Deserialize<'a>>(text: &'a str, arrays: &[&str]) -> Result<T, Mistake> {
    let document = DeTable::parse(text).map_err(|error| Mistake { key: String::new(), error })?;
    if let Some(mistake) = document.get_ref().iter().find_map(|entry| find_needless_array::<T>(entry, arrays))
    {
        return Err(mistake);
    }
    serde_path_to_error::deserialize(Deserializer::from(document)).map_err(|error| {
        let key = error.path().to_string();
        Mistake { key: if key == "." { String::new() } else { key }, error: error.into_inner() }
    })
}

/// Returns the mistake of an entry that is an array and should be a table. serde would read an array as a struct,
/// whose fields may all have defaults.
fn find_needless_array<'a, T: Deserialize<'a>>(
    (spanned_name, value): (&Spanned<Cow<'a, str>>, &Spanned<DeValue<'a>>),
    arrays: &[&str],
) -> Option<Mistake> {
    let name = spanned_name.get_ref();
    if !value.get_ref().is_array() || arrays.contains(&&**name) {
        return None;
    }
    // The advice to write a table would be wrong for an unknown key. A key is unknown if even an empty table with this
    // name is refused as unknown.
    let empty_table = Spanned::new(value.span(), DeValue::Table(DeTable::new()));
    let document = DeTable::from_iter([(spanned_name.clone(), empty_table)]);
    let result = T::deserialize(Deserializer::from(Spanned::new(spanned_name.span(), document)));
    let unknown_key = result.err().filter(|error| error.message().starts_with(UNKNOWN_KEY_PREFIX));
    let needless_array =
        || Error::custom(format!("invalid type: sequence, expected a table: write [{name}] once"));
    Some(Mistake { key: name.to_string(), error: unknown_key.unwrap_or_else(needless_array) })
}

/// Returns all mistakes of a file in which [`read`] found `first_mistake`, and the remainder of the file.
/// Each table and each element of an array of tables is read separately.
pub(super) fn all_mistakes<'a, T: Deserialize<'a>>(
    text: &'a str,
    arrays: &[&str],
    first_mistake: Mistake,
) -> (Vec<Mistake>, Option<Remainder<T>>) {
    let Ok(root) = DeTable::parse(text) else { return (vec![first_mistake], None) };
    let mut mistakes: Vec<Mistake> =
        root.get_ref().iter().filter_map(|entry| find_needless_array::<T>(entry, arrays)).collect();
    let mut tables_with_mistakes: BTreeSet<String> =
        mistakes.iter().map(|mistake| mistake.key.clone()).collect();
    let (mut valid_tables, mut removed_keys, mut indices_in_file) =
        (DeTable::new(), Vec::new(), BTreeMap::new());
    for part in split_into_parts(root.get_ref()) {
        if mistakes.iter().any(|mistake| mistake.key == part.name) {
            continue;
        }
        let count_before = mistakes.len();
        if let Some(valid_document) = part.find_mistakes::<T>(&mut mistakes, &mut removed_keys) {
            part.append_to(valid_document, &mut valid_tables, &mut indices_in_file);
        }
        if mistakes.len() > count_before {
            tables_with_mistakes.insert(part.name);
        }
    }
    if mistakes.is_empty() {
        // Every part by itself is valid, so the first mistake concerns the file as a whole.
        return (vec![first_mistake], None);
    }
    let valid_document = Spanned::new(root.span(), valid_tables);
    let remainder = T::deserialize(Deserializer::from(valid_document)).ok();
    (mistakes, remainder.map(|file| Remainder { file, tables_with_mistakes, removed_keys, indices_in_file }))
}

impl<T> Remainder<T> {
    /// Returns the path that a key of the remainder has in the whole file.
    pub(super) fn key_in_file(&self, key: &str) -> String {
        let in_array = || {
            let (array, rest) = key.split_once('[')?;
            let (index, rest) = rest.split_once(']')?;
            let index = self.indices_in_file.get(array)?.get(index.parse::<usize>().ok()?)?;
            Some(format!("{array}[{index}]{rest}"))
        };
        in_array().unwrap_or_else(|| key.to_owned())
    }

    /// Returns whether a key of the whole file was removed, or is a parent or a child of a removed key.
    pub(super) fn is_removed(&self, key: &str) -> bool {
        let is_within = |key: &str, parent: &str| {
            key.strip_prefix(parent).is_some_and(|rest| rest.is_empty() || rest.starts_with(['.', '[']))
        };
        self.removed_keys.iter().any(|removed_key| is_within(key, removed_key) || is_within(removed_key, key))
    }
}

/// One table of a file, or one element of an array of tables.
struct Part<'a> {
    name: String,
    /// Index of the element in its array; `None` for a table.
    index: Option<usize>,
    /// Document that contains only this part.
    document: Spanned<DeTable<'a>>,
}

/// Returns each table, and each element of each array of tables, as a separate part.
fn split_into_parts<'a>(root: &DeTable<'a>) -> Vec<Part<'a>> {
    let mut parts = Vec::new();
    for (name, value) in root {
        let mut add_part = |index, value: Spanned<DeValue<'a>>| {
            let table = DeTable::from_iter([(name.clone(), value)]);
            let document = Spanned::new(name.span(), table);
            parts.push(Part { name: name.get_ref().to_string(), index, document });
        };
        match value.get_ref() {
            DeValue::Array(elements) if elements.iter().all(|element| element.get_ref().is_table()) => {
                for (index, element) in elements.iter().enumerate() {
                    let mut single_element = DeArray::new();
                    single_element.push(element.clone());
                    add_part(Some(index), Spanned::new(value.span(), DeValue::Array(single_element)));
                }
            }
            _ => add_part(None, value.clone()),
        }
    }
    parts
}

impl<'a> Part<'a> {
    /// Deserialises the part repeatedly, each time without the key that failed, until the rest is valid. Adds the
    /// mistakes and the paths of the removed keys to the lists. Returns the valid rest; `None` if nothing valid
    /// remains.
    fn find_mistakes<T: Deserialize<'a>>(
        &self,
        mistakes: &mut Vec<Mistake>,
        removed_keys: &mut Vec<String>,
    ) -> Option<Spanned<DeTable<'a>>> {
        let mut document = self.document.clone();
        let mut removed = Vec::new();
        while mistakes.len() < MAX_MISTAKES {
            let result = serde_path_to_error::deserialize::<_, T>(Deserializer::from(document.clone()));
            let Err(error) = result else {
                // Nothing valid remains if the part as a whole was removed, for example because a key that it
                // requires was removed.
                document.get_ref().get(self.name.as_str())?;
                removed_keys.extend(removed.iter().map(|steps: &Vec<Step>| self.key(steps)));
                return Some(document);
            };
            let steps = path_steps(error.path());
            let missing = missing_key(error.inner().message());
            // A missing key that was removed here is no mistake in the file. The table that needs the key is removed,
            // too.
            if missing.is_some_and(|name| removed.contains(&join_key(&steps, name))) {
                if remove_key(document.get_mut(), &steps, &mut removed) {
                    continue;
                }
                return None;
            }
            if mistakes.len() + 1 == MAX_MISTAKES {
                let error =
                    Error::custom("the list of mistakes is not complete; correct the listed mistakes first");
                mistakes.push(Mistake { key: String::new(), error });
                return None;
            }
            // A missing key cannot be removed, so the search in this part ends with its first missing key.
            let is_removed = missing.is_none() && remove_key(document.get_mut(), &steps, &mut removed);
            mistakes.push(Mistake { key: self.key(&steps), error: error.into_inner() });
            if !is_removed {
                return None;
            }
        }
        None
    }

    /// Adds the valid rest of this part to the valid tables of the file. An element of an array is appended, and its
    /// index in the file is recorded.
    fn append_to(
        &self,
        valid_document: Spanned<DeTable<'a>>,
        valid_tables: &mut DeTable<'a>,
        indices_in_file: &mut BTreeMap<String, Vec<usize>>,
    ) {
        for (name, value) in valid_document.into_inner() {
            match (self.index, valid_tables.get_mut(name.get_ref().as_ref())) {
                (Some(_), Some(array)) => {
                    if let (DeValue::Array(array), DeValue::Array(single_element)) =
                        (array.get_mut(), value.into_inner())
                    {
                        single_element.into_iter().for_each(|element| array.push(element));
                    }
                }
                _ => drop(valid_tables.insert(name, value)),
            }
            if let Some(index) = self.index {
                indices_in_file.entry(self.name.clone()).or_default().push(index);
            }
        }
    }

    /// Returns the path that a key of this part has in the whole file.
    fn key(&self, steps: &[Step]) -> String {
        let mut key = String::new();
        for (position, step) in steps.iter().enumerate() {
            match (step, self.index) {
                // In the part's document the element has the index 0; `index` is its index in the file.
                (Step::Element(_), Some(index)) if position == 1 => key += &format!("[{index}]"),
                (Step::Element(index), _) => key += &format!("[{index}]"),
                (Step::Key(name), _) if key.is_empty() => key += name,
                (Step::Key(name), _) => key += &format!(".{name}"),
            }
        }
        key
    }
}

/// One element of the path to a key.
#[derive(Clone, Debug, PartialEq, Eq)]
enum Step {
    Key(String),
    Element(usize),
}

/// Returns the steps of a path, up to the first step that names no key and no element.
fn path_steps(path: &Path) -> Vec<Step> {
    path.iter()
        .map_while(|segment| match segment {
            Segment::Map { key } => Some(Step::Key(key.clone())),
            Segment::Seq { index } => Some(Step::Element(*index)),
            Segment::Enum { .. } | Segment::Unknown => None,
        })
        .collect()
}

/// Returns the path of a key in the table at `steps`.
fn join_key(steps: &[Step], name: &str) -> Vec<Step> {
    steps.iter().cloned().chain([Step::Key(name.to_owned())]).collect()
}

/// Returns the name of the missing key, if the error reports one.
fn missing_key(text: &str) -> Option<&str> {
    text.strip_prefix(MISSING_KEY_PREFIX)?.trim().strip_prefix('`')?.split('`').next()
}

/// Removes the key at the end of a path, and adds its path to `removed`. For an element of an array, removes the key of
/// the whole array, because otherwise the indices of the other elements would change. Returns whether the key existed.
fn remove_key(table: &mut DeTable<'_>, steps: &[Step], removed: &mut Vec<Vec<Step>>) -> bool {
    let Some(last_key) = steps.iter().rposition(|step| matches!(step, Step::Key(_))) else { return false };
    let (Some((Step::Key(name), parent)), path) = (steps[..=last_key].split_last(), &steps[..=last_key])
    else {
        return false;
    };
    let Some(table) = inner_table(table, parent) else { return false };
    removed.push(path.to_vec());
    table.remove(name.as_str()).is_some()
}

/// Returns the table at the end of a path; `None` if there is no table.
fn inner_table<'t, 'i>(table: &'t mut DeTable<'i>, steps: &[Step]) -> Option<&'t mut DeTable<'i>> {
    let Some((first, rest)) = steps.split_first() else { return Some(table) };
    let Step::Key(name) = first else { return None };
    let (_, value) = table.iter_mut().find(|(key, _)| key.get_ref() == name)?;
    let mut value = value.get_mut();
    let mut rest = rest;
    while let Some((Step::Element(index), next_steps)) = rest.split_first() {
        let DeValue::Array(elements) = value else { return None };
        value = elements.get_mut(*index)?.get_mut();
        rest = next_steps;
    }
    match value {
        DeValue::Table(inner) => inner_table(inner, rest),
        _ => None,
    }
}

impl fmt::Display for Mistake {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}", self.key, self.error.message())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ARRAYS: [&str; 1] = ["element"];

    #[derive(Debug, Deserialize)]
    #[serde(deny_unknown_fields)]
    struct File {
        #[serde(default)]
        first: First,
        #[serde(default)]
        second: BTreeMap<String, u8>,
        #[serde(default)]
        element: Vec<Element>,
    }

    #[derive(Debug, Default, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    struct First {
        number: u8,
        list: Vec<u8>,
    }

    #[derive(Debug, Deserialize)]
    #[serde(deny_unknown_fields)]
    #[expect(dead_code, reason = "the tests look only at mistakes in these fields")]
    struct Element {
        name: String,
        kind: Kind,
        number: Option<u8>,
    }

    #[derive(Debug, Deserialize)]
    #[serde(tag = "kind", rename_all = "kebab-case", deny_unknown_fields)]
    #[expect(dead_code, reason = "the tests look only at mistakes in these fields")]
    enum Kind {
        One { size: u8 },
    }

    fn mistakes_and_remainder(text: &str) -> (Vec<String>, Option<Remainder<File>>) {
        let first_mistake = read::<File>(text, &ARRAYS).expect_err("the file has a mistake");
        let (mistakes, remainder) = all_mistakes(text, &ARRAYS, first_mistake);
        (mistakes.iter().map(ToString::to_string).collect(), remainder)
    }

    #[test]
    fn all_mistakes_of_all_tables_are_found_once() {
        let (reported, remainder) = mistakes_and_remainder(
            "third = 1\n[first]\nnumbr = 1\nnumber = 'x'\nlist = [1, 'y', 2]\n[second]\na = 1\n\
             [[element]]\nname = 'a'\nkind = { kind = 'one', size = 1 }\n\
             [[element]]\nkind = { kind = 'one', size = 1, sise = 1 }\nnumber = -1\n\
             [[element]]\nname = 1\nkind = { kind = 'two' }\n",
        );
        for (expected, text) in [
            ("third: ", "unknown field `third`"),
            ("first.numbr: ", "unknown field `numbr`"),
            ("first.number: ", "invalid type"),
            ("first.list[1]: ", "invalid type"),
            ("element[1].kind: ", "unknown field `sise`"),
            ("element[1].number: ", "invalid value"),
            ("element[1]: ", "missing field `name`"),
            ("element[2].name: ", "invalid type"),
            ("element[2].kind", "unknown variant `two`"),
        ] {
            let is_expected = |mistake: &&String| mistake.starts_with(expected) && mistake.contains(text);
            assert_eq!(reported.iter().filter(is_expected).count(), 1, "{expected}{text} in {reported:#?}");
        }
        assert_eq!(reported.len(), 9, "{reported:#?}");
        let remainder = remainder.expect("the remainder can be read");
        assert_eq!(remainder.tables_with_mistakes, ["element", "first", "third"].map(str::to_owned).into());
        assert_eq!(
            (remainder.file.second.len(), remainder.file.first.number, remainder.file.element.len()),
            (1, 0, 1)
        );
    }

    #[test]
    fn unknown_array_of_tables_is_unknown_key() {
        let (reported, _) = mistakes_and_remainder("[[elements]]\nname = 'a'\n[[elements]]\nname = 'b'\n");
        let [mistake] = &reported[..] else { panic!("one mistake: {reported:#?}") };
        assert!(mistake.starts_with("elements: unknown field `elements`"), "{mistake}");
    }

    #[test]
    fn keys_of_remainder_get_indices_of_whole_file() {
        let (_, remainder) = mistakes_and_remainder(
            "[first]\nnumber = 'x'\nlist = [1, 2]\n[[element]]\nname = 'a'\n\
             [[element]]\nname = 'b'\nkind = { kind = 'one', size = 1 }\nnumber = 'x'\n",
        );
        let remainder = remainder.expect("the remainder can be read");
        assert_eq!(remainder.file.first.list, [1, 2]);
        let [element] = &remainder.file.element[..] else { panic!("only the element with a kind remains") };
        assert_eq!((element.name.as_str(), element.number), ("b", None));
        assert_eq!(remainder.key_in_file("element[0].name"), "element[1].name");
        assert_eq!(remainder.key_in_file("first.list[1]"), "first.list[1]");
        for (key, is_removed) in [
            ("first.number", true),
            ("first", true),
            ("first.list", false),
            ("element[1].number.x", true),
            ("element[1].name", false),
        ] {
            assert_eq!(remainder.is_removed(key), is_removed, "{key}");
        }
    }

    #[test]
    fn truncated_list_of_mistakes_is_marked_as_incomplete() {
        let keys: String = (0..200).map(|key| format!("k{key} = 1\n")).collect();
        let (reported, _) = mistakes_and_remainder(&format!("[first]\n{keys}"));
        assert_eq!(reported.len(), MAX_MISTAKES);
        assert!(reported[MAX_MISTAKES - 1].contains("not complete"), "{reported:#?}");
    }

    #[test]
    fn single_mistake_is_reported_as_by_read() {
        for text in [
            "[first]\nnumbr = 1\n",
            "[first]\nnumber = 256\n",
            "[[element]]\nname = 'a'\nkind = { kind = 'one', size = 1 }\n[[element]]\nname = 'a'\n",
            "first = 3\n",
            "first = []\n",
            "[first\n",
        ] {
            let first_mistake = read::<File>(text, &ARRAYS).expect_err("the file has a mistake");
            let (expected, span) = (first_mistake.to_string(), first_mistake.error.span());
            let (mistakes, _) = all_mistakes::<File>(text, &ARRAYS, first_mistake);
            let [mistake] = &mistakes[..] else { panic!("one mistake in {text}: {mistakes:#?}") };
            assert_eq!((mistake.to_string(), mistake.error.span()), (expected, span), "{text}");
        }
    }
}
