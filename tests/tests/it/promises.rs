//! Tests of the documents for developers: the tests, files, functions and libraries that they name exist.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

use peernet_tests::{Document, root};

const ARCHITECTURE: &str = "ARCHITECTURE.md";
const DEPENDENCIES: &str = "docs/development/dependencies.md";
const GUARANTEES: &str = "docs/development/guarantees.md";
/// Folders with code, without those of build results.
const CODE: [&str; 10] = [
    "configs",
    "daemon",
    "deploy",
    "docs",
    "fuzz",
    "migrations",
    "tests/ports",
    "tests/src",
    "tests/tests",
    "web",
];

/// Names in the table of libraries that are not crates of the workspace: a renamed crate, and a command.
const OTHER_NAMES: [&str; 2] = ["omq-tokio", "chronyc"];

/// Adds all files and folders below a folder to `found`.
fn add_paths(folder: &Path, found: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(folder).expect("it can be listed") {
        let path = entry.expect("it can be listed").path();
        if path.is_dir() {
            add_paths(&path, found);
        }
        found.push(path);
    }
}

fn code_paths() -> Vec<PathBuf> {
    let mut found: Vec<PathBuf> = CODE.iter().map(|folder| root().join(folder)).collect();
    CODE.iter().for_each(|folder| add_paths(&root().join(folder), &mut found));
    found
}

/// Returns the texts between back quotes that contain no white space.
fn quoted(text: &str) -> impl Iterator<Item = &str> {
    text.lines().flat_map(|line| line.split('`').skip(1).step_by(2)).filter(|code| !code.contains(' '))
}

/// Returns names of tests: lower-case letters, digits and at least two underscores.
fn test_names(text: &str) -> impl Iterator<Item = &str> {
    let is_name_character = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '_';
    quoted(text).filter(move |code| code.matches('_').count() > 1 && code.chars().all(is_name_character))
}

/// Returns the names of all functions in the code.
fn functions() -> BTreeSet<String> {
    let mut functions = BTreeSet::new();
    for file in code_paths().iter().filter(|path| path.extension().is_some_and(|ending| ending == "rs")) {
        let text = fs::read_to_string(file).expect("it is text");
        let names = text.split("fn ").filter_map(|after| after.split_once(['(', '<']));
        functions.extend(names.map(|(name, _)| name.trim().to_owned()));
    }
    functions
}

#[test]
fn every_promise_names_tests_that_exist() {
    let functions = functions();
    let guarantees = Document::read(GUARANTEES);
    let rows = guarantees.section("promises-and-their-tests").lines();
    let mut promises = 0;
    for row in rows.filter(|line| line.starts_with('|')).skip(2) {
        promises += 1;
        assert!(test_names(row).next().is_some(), "no test is named in {row}");
        for test in test_names(row) {
            assert!(functions.contains(test), "there is no test {test}: {row}");
        }
    }
    assert!(promises > 10, "{promises}");
}

#[test]
fn paths_in_documents_exist() {
    let code_paths = code_paths();
    let is_path_character = |c: char| c.is_ascii_alphanumeric() || "_-./".contains(c);
    let mut checked_paths = 0;
    for name in [ARCHITECTURE, DEPENDENCIES, GUARANTEES, "docs/development/protocol-versions.md"] {
        let document = Document::read(name);
        let paths = quoted(&document.text)
            .filter(|code| code.trim_matches('/').contains('/') && code.chars().all(is_path_character))
            .filter(|path| !path.starts_with('/'));
        for path in paths {
            checked_paths += 1;
            let (file, module) = (Path::new(path), format!("{path}.rs"));
            let is_path = |candidate: &PathBuf| candidate.ends_with(file) || candidate.ends_with(&module);
            assert!(code_paths.iter().any(is_path), "{name}: {path} does not exist");
        }
    }
    assert!(checked_paths > 20, "{checked_paths}");
}

#[test]
fn functions_named_in_architecture_exist() {
    let functions = functions();
    let architecture = Document::read(ARCHITECTURE);
    let calls: Vec<&str> = quoted(&architecture.text).filter_map(|code| code.strip_suffix("()")).collect();
    for call in &calls {
        let name = call.rsplit("::").next().expect("a split has a part");
        assert!(functions.contains(name), "there is no function {call}");
    }
    assert!(calls.len() > 8, "{calls:?}");
}

#[test]
fn every_library_is_listed_with_its_reason() {
    let manifest = fs::read_to_string(root().join("Cargo.toml")).expect("it is there");
    let manifest: toml::Table = manifest.parse().expect("it is TOML");
    let libraries = manifest["workspace"]["dependencies"].as_table().expect("it is a table");
    let document = Document::read(DEPENDENCIES);
    let rows = document.section("libraries").lines().filter(|line| line.starts_with('|')).skip(2);
    let listed: BTreeSet<&str> = rows.filter_map(|row| row.split('|').nth(2)).flat_map(quoted).collect();
    let is_external = |library: &&String| !library.starts_with("peernet-");
    let unlisted: Vec<_> =
        libraries.keys().filter(is_external).filter(|name| !listed.contains(name.as_str())).collect();
    assert!(unlisted.is_empty(), "{DEPENDENCIES} does not say why these were chosen: {unlisted:?}");
    let is_known = |name: &&&str| OTHER_NAMES.contains(*name) || libraries.contains_key(**name);
    let unused: Vec<_> = listed.iter().filter(|name| !is_known(name)).collect();
    assert!(unused.is_empty(), "{DEPENDENCIES} names libraries that the workspace does not use: {unused:?}");
}
