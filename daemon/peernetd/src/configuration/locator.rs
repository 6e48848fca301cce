//! Line numbers of keys, so that a problem names file, line and key.

use peernet_cli::renamed_tables::RENAMED_TABLES;
use toml::Spanned;
use toml::de::{DeTable, DeValue};

/// Finds the lines of keys in a configuration file.
pub(crate) struct Locator<'a> {
    text: &'a str,
    root: Option<Spanned<DeTable<'a>>>,
}

impl<'a> Locator<'a> {
    /// Creates a locator for the text of a file. A text that is not TOML has no keys.
    pub(crate) fn new(text: &'a str) -> Self {
        Self { text, root: DeTable::parse(text).ok() }
    }

    /// Returns the line, from 1, of a key such as `pipeline[1].sensor.path`. A key that is not in the file, because
    /// its default applies, has the line of its nearest parent in the file.
    pub(crate) fn line(&self, key: &str) -> Option<usize> {
        let root = self.root.as_ref()?;
        let mut table = root.get_ref();
        let mut line = None;
        for step in key.split('.') {
            let (name, index) = match step.strip_suffix(']').and_then(|step| step.split_once('[')) {
                Some((name, index)) => (name, index.parse::<usize>().ok()),
                None => (step, None),
            };
            // Only tables at the top of the file were renamed. `line` is set after the first step.
            let is_named = |name_in_file: &str| {
                name_in_file == name || (line.is_none() && is_former_name(name_in_file, name))
            };
            let Some((name_in_file, value)) =
                table.iter().find(|(name_in_file, _)| is_named(name_in_file.get_ref()))
            else {
                break;
            };
            line = Some(self.line_at(name_in_file.span().start));
            let value = match (value.get_ref(), index) {
                (DeValue::Array(items), Some(index)) => match items.get(index) {
                    Some(item) => {
                        line = Some(self.line_at(item.span().start));
                        item.get_ref()
                    }
                    None => break,
                },
                (value, _) => value,
            };
            match value {
                DeValue::Table(inner) => table = inner,
                _ => break,
            }
        }
        line
    }

    /// Returns the line, from 1, of a byte offset in the text.
    pub(crate) fn line_at(&self, offset: usize) -> usize {
        self.text.bytes().take(offset).filter(|byte| *byte == b'\n').count() + 1
    }
}

/// Returns whether `name_in_file` is the former name of the table whose current name is `name`.
fn is_former_name(name_in_file: &str, name: &str) -> bool {
    RENAMED_TABLES.iter().any(|table| (table.former, table.current) == (name_in_file, name))
}

#[cfg(test)]
mod tests {
    use super::*;

    const TEXT: &str = "[agent]\nname = \"a\"\n\n[[pipeline]]\nname = \"one\"\n\n[[pipeline]]\nname = \"two\"\nsensor = { kind = \"images\",\n  path = \"x\" }\n";

    #[test]
    fn line_of_key_is_found() {
        let locator = Locator::new(TEXT);
        assert_eq!(locator.line("agent.name"), Some(2));
        assert_eq!(locator.line("pipeline[0].name"), Some(5));
        assert_eq!(locator.line("pipeline[1].sensor.path"), Some(10));
        assert_eq!(Locator::new("\n[rehearsal]\nsteps = 1\n").line("clock_fault.steps"), Some(3));
    }

    #[test]
    fn missing_key_has_line_of_its_parent() {
        let locator = Locator::new(TEXT);
        assert_eq!(locator.line("pipeline[1].timeout_ms"), locator.line("pipeline[1]"));
        assert_eq!(locator.line("agent.state_dir"), Some(1));
        assert_eq!(locator.line("web.listen"), None);
        assert_eq!(Locator::new("= nonsense").line("agent"), None);
    }
}
