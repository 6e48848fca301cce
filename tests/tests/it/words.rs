//! Rules of CONTRIBUTING.md for words, as far as a program can check them.

use std::collections::BTreeSet;
use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::Command;

use peernet_tests::{Document, root};
use syn::visit::Visit;

/// Words that are no names of types: metaphors, adverbs, and participles without a noun.
const BANNED_TYPE_NAMES: &[&str] = &[
    "Aloft",
    "Aside",
    "Beside",
    "Blame",
    "Bed",
    "Board",
    "Brake",
    "Came",
    "Chance",
    "Complaints",
    "Concerning",
    "Desk",
    "Dice",
    "Doors",
    "Early",
    "Errand",
    "Eyes",
    "Farewell",
    "Five",
    "Freed",
    "Happened",
    "Heard",
    "Hole",
    "Home",
    "Homes",
    "Judged",
    "Known",
    "Lacking",
    "Landed",
    "Lanes",
    "Litter",
    "Manners",
    "Moment",
    "Near",
    "News",
    "Now",
    "Only",
    "Other",
    "Own",
    "Patience",
    "Pauses",
    "Plant",
    "Room",
    "Said",
    "Seen",
    "Senses",
    "Shelf",
    "Short",
    "Since",
    "Skim",
    "Slow",
    "Standing",
    "Stock",
    "Stranger",
    "Surprises",
    "Surroundings",
    "Suspects",
    "Taken",
    "Then",
    "Thinned",
    "Ticket",
    "Told",
    "Tried",
    "Trouble",
    "Untaken",
    "Voice",
    "Watchman",
    "Way",
    "Where",
    "Which",
    "Wishes",
    "World",
];

/// Folders with Rust code.
const CODE: [&str; 4] = ["daemon", "web", "tests", "fuzz"];

/// Maximum number of words in a paragraph of a document.
const MAX_PARAGRAPH_WORDS: usize = 120;

fn add_rust_files(folder: &Path, found: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(folder).expect("the folder can be listed") {
        let path = entry.expect("the folder can be listed").path();
        let name = path.file_name().expect("an entry has a name");
        if path.is_dir() && !["target", "node_modules"].iter().any(|skipped| name == *skipped) {
            add_rust_files(&path, found);
        } else if path.extension().is_some_and(|extension| extension == "rs") {
            found.push(path);
        }
    }
}

#[derive(Default)]
struct TypeNames(BTreeSet<String>);

impl<'ast> Visit<'ast> for TypeNames {
    fn visit_item_struct(&mut self, item: &'ast syn::ItemStruct) {
        self.0.insert(item.ident.to_string());
    }

    fn visit_item_enum(&mut self, item: &'ast syn::ItemEnum) {
        self.0.insert(item.ident.to_string());
    }

    fn visit_item_trait(&mut self, item: &'ast syn::ItemTrait) {
        self.0.insert(item.ident.to_string());
        syn::visit::visit_item_trait(self, item);
    }

    fn visit_item_type(&mut self, item: &'ast syn::ItemType) {
        self.0.insert(item.ident.to_string());
    }

    fn visit_trait_item_type(&mut self, item: &'ast syn::TraitItemType) {
        self.0.insert(item.ident.to_string());
    }
}

#[test]
fn no_type_has_a_banned_name() {
    let mut files = Vec::new();
    CODE.iter().for_each(|folder| add_rust_files(&root().join(folder), &mut files));
    let mut banned = Vec::new();
    for file in &files {
        let text = fs::read_to_string(file).expect("the file is text");
        let syntax = syn::parse_file(&text).unwrap_or_else(|error| panic!("{}: {error}", file.display()));
        let mut names = TypeNames::default();
        names.visit_file(&syntax);
        let found = names.0.iter().filter(|name| BANNED_TYPE_NAMES.contains(&name.as_str()));
        banned.extend(found.map(|name| format!("{}: {name}", file.display())));
    }
    assert!(files.len() > 500, "only {} files were read", files.len());
    assert!(banned.is_empty(), "names that do not say what these types are: {banned:#?}");
}

/// Returns the paragraphs of a document outside tables and blocks of code, with the numbers of their
/// first lines.
fn paragraphs(document: &Document) -> Vec<(usize, String)> {
    let mut paragraphs: Vec<(usize, String)> = Vec::new();
    let mut is_open = false;
    for (number, line) in document.prose() {
        let is_text = !line.is_empty() && !line.starts_with(['|', '#']) && !line.starts_with("    ");
        let begin = line.trim_start().trim_start_matches(|c: char| c.is_ascii_digit());
        let is_item = begin.starts_with("- ") || begin.starts_with(". ");
        match paragraphs.last_mut() {
            Some((_, text)) if is_open && is_text && !is_item => {
                text.push(' ');
                text.push_str(line);
            }
            _ if is_text => paragraphs.push((number, line.to_owned())),
            _ => {}
        }
        is_open = is_text;
    }
    paragraphs
}

#[test]
fn paragraphs_of_documents_are_short() {
    let mut long_paragraphs = Vec::new();
    for document in Document::all() {
        for (number, text) in paragraphs(&document) {
            let words = text.split_whitespace().count();
            if words > MAX_PARAGRAPH_WORDS {
                long_paragraphs.push(format!("{}:{number}: {words} words", document.path.display()));
            }
        }
    }
    assert!(
        long_paragraphs.is_empty(),
        "paragraphs of more than {MAX_PARAGRAPH_WORDS} words: {long_paragraphs:#?}"
    );
}

fn is_accepted(subject: &str) -> bool {
    let mut message = tempfile::NamedTempFile::new().expect("a file can be made");
    writeln!(message, "# a comment\n{subject}\n\nBody.").expect("the file can be written");
    let hook = root().join("deploy/hooks/commit-msg");
    Command::new(hook).arg(message.path()).output().expect("the hook can be started").status.success()
}

#[test]
fn commit_hook_accepts_area_and_summary_only() {
    for subject in [
        "agent: name the peer of an unresponsive host",
        "clock, probes: read raw stamps",
        "Revert \"web: x\"",
    ] {
        assert!(is_accepted(subject), "{subject}");
    }
    let long_subject = format!("agent: {}", "x".repeat(80));
    for subject in ["Agent: name it", "name the peer", "agent: Name it", "agent: name it.", &long_subject] {
        assert!(!is_accepted(subject), "{subject}");
    }
}
