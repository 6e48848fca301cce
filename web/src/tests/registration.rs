//! Checks that a module of a page or a REST resource is named in its registration file (`mod.rs`) and in no other
//! module.

use std::fs;
use std::path::{Path, PathBuf};

/// A folder of modules that its `mod.rs` registers.
struct Registry {
    folder: &'static str,
    /// Modules of the folder that register nothing; the other modules use them.
    unregistered: &'static [&'static str],
    /// Text that follows the name of a registered module in `mod.rs`.
    registration_suffix: &'static str,
}

const REGISTRIES: [Registry; 2] = [
    Registry { folder: "api", unregistered: &["openapi", "schema"], registration_suffix: "::routes()" },
    Registry {
        folder: "pages",
        unregistered: &["error", "registration", "shell", "tests"],
        registration_suffix: "::PAGE",
    },
];

fn source() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("src")
}

/// Adds the path and the text of each Rust file and template in a folder and its subfolders, without tests.
fn add_files(folder: &Path, files: &mut Vec<(PathBuf, String)>) {
    for entry in fs::read_dir(folder).expect("a folder") {
        let path = entry.expect("an entry").path();
        let name = path.file_stem().and_then(|name| name.to_str()).expect("a name");
        if name == "tests" || name.ends_with("_tests") {
            continue;
        }
        if path.is_dir() {
            add_files(&path, files);
        } else if path.extension().is_some_and(|ending| ending == "rs" || ending == "html") {
            let text = fs::read_to_string(&path).expect("a text");
            let text = text.split("#[cfg(test)]\nmod tests {").next().unwrap_or_default().to_owned();
            files.push((path, text));
        }
    }
}

/// Returns the first name behind `module::` in each path: `a` and `b` of `module::{a::c, b}`, `d` of `module::d`.
fn names_below<'a>(text: &'a str, module: &str) -> Vec<&'a str> {
    let first = |path: &'a str| {
        let path = path.trim_start();
        path.split(|letter: char| !letter.is_alphanumeric() && letter != '_').next().unwrap_or_default()
    };
    let prefix = format!("{module}::");
    text.split(&prefix)
        .skip(1)
        .flat_map(|rest| match rest.strip_prefix('{') {
            Some(group) => group.split('}').next().unwrap_or_default().split(',').map(first).collect(),
            None => vec![first(rest)],
        })
        .collect()
}

#[test]
fn module_is_named_in_its_registration_file_only() {
    let mut files = Vec::new();
    add_files(&source(), &mut files);
    for Registry { folder, unregistered, registration_suffix } in REGISTRIES {
        let folder = source().join(folder);
        let registration = folder.join("mod.rs");
        let text = fs::read_to_string(&registration).expect("the registration file");
        let modules = text.lines().filter_map(|line| line.strip_prefix("mod ")?.strip_suffix(';'));
        let modules: Vec<&str> = modules.filter(|module| !unregistered.contains(module)).collect();
        assert!(modules.len() > 10, "{modules:?}");
        for module in modules {
            assert!(text.contains(&format!("{module}{registration_suffix}")), "{module} is not registered");
            for (path, text) in &files {
                let is_of_module =
                    path.starts_with(folder.join(module)) || *path == folder.join(format!("{module}.rs"));
                if is_of_module || *path == registration {
                    continue;
                }
                let parent = folder.file_name().and_then(|name| name.to_str()).expect("a name");
                let mut named = names_below(text, parent);
                // Below the folder, `super` may be the module of the folder.
                if path.starts_with(&folder) {
                    named.extend(names_below(text, "super"));
                }
                assert!(!named.contains(&module), "{} names {module}", path.display());
            }
        }
    }
}

#[test]
fn names_in_groups_and_in_single_paths_are_found() {
    let text = "use super::{page, hosts::Line};\nuse crate::pages::host;\nlet it = crate::pages::run::show;";
    assert_eq!(names_below(text, "super"), ["page", "hosts"]);
    assert_eq!(names_below(text, "pages"), ["host", "run"]);
}
