//! Tests that ARCHITECTURE.md is right: the tests that it names for each promise exist, and so do the files.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

use peernet_tests::{Document, root};

const DOCUMENT: &str = "ARCHITECTURE.md";
const SECTION: &str = "what-is-promised-and-what-keeps-it";
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
fn below(folder: &Path, found: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(folder).expect("it can be listed") {
        let path = entry.expect("it can be listed").path();
        if path.is_dir() {
            below(&path, found);
        }
        found.push(path);
    }
}

fn code() -> Vec<PathBuf> {
    let mut found: Vec<PathBuf> = CODE.iter().map(|folder| root().join(folder)).collect();
    CODE.iter().for_each(|folder| below(&root().join(folder), &mut found));
    found
}

/// Returns the texts between back quotes that contain no white space.
fn quoted(text: &str) -> impl Iterator<Item = &str> {
    text.lines().flat_map(|line| line.split('`').skip(1).step_by(2)).filter(|code| !code.contains(' '))
}

/// Returns names of tests: lower-case letters, digits and at least two underscores.
fn tests(text: &str) -> impl Iterator<Item = &str> {
    let small = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '_';
    quoted(text).filter(move |code| code.matches('_').count() > 1 && code.chars().all(small))
}

#[test]
fn every_promise_names_tests_that_exist() {
    let mut functions = BTreeSet::new();
    for file in code().iter().filter(|path| path.extension().is_some_and(|ending| ending == "rs")) {
        let text = fs::read_to_string(file).expect("it is text");
        functions
            .extend(text.split("fn ").filter_map(|after| Some(after.split_once('(')?.0.trim().to_owned())));
    }
    let architecture = Document::read(DOCUMENT);
    let rows = architecture.section(SECTION).lines().filter(|line| line.starts_with('|')).skip(2);
    let mut promises = 0;
    for row in rows {
        promises += 1;
        assert!(tests(row).next().is_some(), "no test keeps {row}");
        for test in tests(row) {
            assert!(functions.contains(test), "there is no test {test}: {row}");
        }
    }
    assert!(promises > 10, "{promises}");
}

#[test]
fn every_path_in_architecture_exists() {
    let code = code();
    let plain = |c: char| c.is_ascii_alphanumeric() || "_-./".contains(c);
    let architecture = Document::read(DOCUMENT);
    let paths = quoted(&architecture.text)
        .filter(|code| code.trim_matches('/').contains('/') && code.chars().all(plain))
        .filter(|path| !path.starts_with('/'));
    let mut looked_at = 0;
    for path in paths {
        looked_at += 1;
        let (file, module) = (Path::new(path), format!("{path}.rs"));
        let leads = |there: &PathBuf| there.ends_with(file) || there.ends_with(&module);
        assert!(code.iter().any(leads), "{path} is nowhere");
    }
    assert!(looked_at > 20, "{looked_at}");
}

#[test]
fn architecture_lists_every_library() {
    let manifest = fs::read_to_string(root().join("Cargo.toml")).expect("it is there");
    let manifest: toml::Table = manifest.parse().expect("it is TOML");
    let libraries = manifest["workspace"]["dependencies"].as_table().expect("it is a table");
    let architecture = Document::read(DOCUMENT);
    let rows = architecture.section("libraries").lines().filter(|line| line.starts_with('|')).skip(2);
    let named: BTreeSet<&str> = rows.filter_map(|row| row.split('|').nth(2)).flat_map(quoted).collect();
    let ours = |library: &&String| !library.starts_with("peernet-");
    let unnamed: Vec<_> =
        libraries.keys().filter(ours).filter(|name| !named.contains(name.as_str())).collect();
    assert!(unnamed.is_empty(), "{DOCUMENT} does not say why these were chosen: {unnamed:?}");
    let known = |name: &&&str| OTHER_NAMES.contains(*name) || libraries.contains_key(**name);
    let gone: Vec<_> = named.iter().filter(|name| !known(name)).collect();
    assert!(gone.is_empty(), "{DOCUMENT} names what the workspace does not depend on: {gone:?}");
}
