//! The documents, from which tests extract examples.

mod commands;

use std::path::{Path, PathBuf};

use crate::root;

/// Markdown file of the checkout.
#[derive(Debug)]
pub struct Document {
    /// Path below the root.
    pub path: PathBuf,
    /// Whole text.
    pub text: String,
}

impl Document {
    /// Reads a file below the root.
    ///
    /// # Panics
    /// If it cannot be read.
    pub fn read(path: impl Into<PathBuf>) -> Self {
        let path = path.into();
        let text = std::fs::read_to_string(root().join(&path))
            .unwrap_or_else(|error| panic!("cannot read {}: {error}", path.display()));
        Self { path, text }
    }

    /// Returns the documents for users: the README and the folders `docs` and `docs/experiments`.
    ///
    /// # Panics
    /// If they do not exist.
    pub fn for_users() -> Vec<Self> {
        let files = |folder: &'static str| {
            let entries = std::fs::read_dir(root().join(folder)).expect("the folder exists");
            let paths = entries.map(move |entry| {
                Path::new(folder).join(entry.expect("the folder can be listed").file_name())
            });
            paths.filter(|path| path.extension().is_some_and(|ending| ending == "md"))
        };
        let docs = files("docs").chain(files("docs/experiments"));
        std::iter::once(PathBuf::from("README.md")).chain(docs).map(Self::read).collect()
    }

    /// Returns the documents for users and contributors.
    pub fn all() -> Vec<Self> {
        let others = [
            "ARCHITECTURE.md",
            "CONTRIBUTING.md",
            "deploy/README.md",
            "docs/development/dependencies.md",
            "docs/development/guarantees.md",
            "docs/development/protocol-versions.md",
            "models/README.md",
        ];
        Self::for_users().into_iter().chain(others.map(Self::read)).collect()
    }

    /// Returns the lines outside of fenced blocks, numbered from 1.
    pub fn prose(&self) -> impl Iterator<Item = (usize, &str)> {
        let mut is_in_block = false;
        self.text.lines().enumerate().filter_map(move |(index, line)| {
            let is_fence = line.trim_start().starts_with("```");
            is_in_block ^= is_fence;
            (!is_in_block && !is_fence).then_some((index + 1, line))
        })
    }

    /// Returns the fenced blocks of a language, with the numbers of their first lines.
    pub fn fenced_blocks(&self, language: &str) -> Vec<(usize, String)> {
        let opening = format!("```{language}");
        let mut blocks = Vec::new();
        let mut lines = self.text.lines().enumerate();
        while let Some((index, line)) = lines.next() {
            let indent = line.len() - line.trim_start().len();
            if !line.trim_start().starts_with("```") {
                continue;
            }
            let body = lines.by_ref().map(|(_, line)| line.get(indent..).unwrap_or_default());
            let body: Vec<&str> = body.take_while(|line| !line.starts_with("```")).collect();
            if line.trim() == opening {
                blocks.push((index + 2, body.join("\n") + "\n"));
            }
        }
        blocks
    }

    /// Returns the blocks of a section that are indented by this number of spaces.
    pub fn indented_blocks(&self, section: &str, spaces: usize) -> Vec<String> {
        let (indent, mut blocks, mut is_open) = (" ".repeat(spaces), Vec::<String>::new(), false);
        for line in self.section(section).lines() {
            match line.strip_prefix(&indent) {
                Some(line) if is_open => blocks.last_mut().expect("a block is open").extend([line, "\n"]),
                Some(line) => blocks.push(format!("{line}\n")),
                None if line.is_empty() && is_open => blocks.last_mut().expect("a block is open").push('\n'),
                None => {}
            }
            is_open = line.starts_with(&indent) || (is_open && line.is_empty());
        }
        blocks
    }

    /// Returns the targets of links, with the numbers of their lines.
    pub fn links(&self) -> impl Iterator<Item = (usize, &str)> {
        self.prose().flat_map(|(number, line)| {
            let targets = line.split("](").skip(1).filter_map(|rest| rest.split([')', ' ']).next());
            targets.map(move |target| (number, target))
        })
    }

    /// Returns the anchors of all headings.
    pub fn anchors(&self) -> Vec<String> {
        self.prose().filter(|(_, line)| line.starts_with('#')).map(|(_, line)| anchor(line)).collect()
    }

    /// Returns the text from a heading to the next one of the same or a higher level.
    ///
    /// # Panics
    /// If there is no such section.
    pub fn section(&self, name: &str) -> &str {
        let level = |line: &str| line.chars().take_while(|char| *char == '#').count();
        let mut headings = self.prose().filter(|(_, line)| line.starts_with('#'));
        let (heading_line, heading) = headings
            .find(|(_, line)| anchor(line) == name)
            .unwrap_or_else(|| panic!("{} has no section {name}", self.path.display()));
        let next = headings.find(|(_, line)| level(line) <= level(heading));
        let start = |number: usize| self.text.split_inclusive('\n').take(number - 1).map(str::len).sum();
        &self.text[start(heading_line)..next.map_or(self.text.len(), |(number, _)| start(number))]
    }
}

/// Returns a heading's anchor as GitHub and GitLab form it: lower case, without punctuation, with hyphens for spaces.
fn anchor(heading: &str) -> String {
    let text = heading.trim_start_matches('#').trim().to_lowercase();
    let chars = text.chars().filter(|char| char.is_alphanumeric() || " -_".contains(*char));
    chars.map(|char| if char == ' ' { '-' } else { char }).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    const TEXT: &str = "# One\n```toml\na = 1\n```\n1. It:\n\n       b = 2\n\n       c = 3\n\n   Then:\n\n       d = 4\n\
                        # Two words\n   ```sh\n   # no heading\n   ls\n   ```\n";

    #[test]
    fn blocks_are_found_in_their_sections() {
        let document = Document { path: PathBuf::new(), text: TEXT.to_owned() };
        assert_eq!(document.fenced_blocks("toml"), [(3, "a = 1\n".to_owned())]);
        assert_eq!(document.fenced_blocks("sh"), [(16, "# no heading\nls\n".to_owned())]);
        assert_eq!(document.indented_blocks("one", 7), ["b = 2\n\nc = 3\n\n", "d = 4\n"]);
        assert_eq!(document.anchors(), ["one", "two-words"]);
    }
}
