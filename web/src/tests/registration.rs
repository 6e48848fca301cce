//! Pages and REST resources are named in their registration files and nowhere else.

use std::fs;
use std::path::{Path, PathBuf};

/// A folder of modules that its `mod.rs` registers.
struct Registry {
    folder: &'static str,
    /// Modules of the folder that register nothing, because they are parts of the others.
    shared: &'static [&'static str],
    /// Text after a module's name in its registration.
    registered: &'static str,
}

const REGISTRIES: [Registry; 2] = [
    Registry { folder: "api", shared: &["openapi", "schema"], registered: "::routes()" },
    Registry { folder: "pages", shared: &["error", "kind", "shell", "tests"], registered: "::PAGE" },
];

fn source() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("src")
}

/// Adds the path and the text of each file of the program in a folder and its subfolders. Tests are omitted.
fn add_files(folder: &Path, found: &mut Vec<(PathBuf, String)>) {
    for entry in fs::read_dir(folder).expect("a folder") {
        let path = entry.expect("an entry").path();
        let name = path.file_stem().and_then(|name| name.to_str()).expect("a name");
        if name == "tests" || name.ends_with("_tests") {
            continue;
        }
        if path.is_dir() {
            add_files(&path, found);
        } else if path.extension().is_some_and(|ending| ending == "rs" || ending == "html") {
            let text = fs::read_to_string(&path).expect("a text");
            let text = text.split("#[cfg(test)]\nmod tests {").next().unwrap_or_default().to_owned();
            found.push((path, text));
        }
    }
}

/// Returns the first names of all paths below a module: `a` and `b` of `module::{a::c, b}`, `d` of `module::d`.
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
    for Registry { folder, shared, registered } in REGISTRIES {
        let folder = source().join(folder);
        let registration = folder.join("mod.rs");
        let text = fs::read_to_string(&registration).expect("the registration file");
        let modules = text.lines().filter_map(|line| line.strip_prefix("mod ")?.strip_suffix(';'));
        let modules: Vec<&str> = modules.filter(|module| !shared.contains(module)).collect();
        assert!(modules.len() > 10, "{modules:?}");
        for module in modules {
            assert!(text.contains(&format!("{module}{registered}")), "{module} is not registered");
            for (path, text) in &files {
                let is_own =
                    path.starts_with(folder.join(module)) || *path == folder.join(format!("{module}.rs"));
                if is_own || *path == registration {
                    continue;
                }
                let parent = folder.file_name().and_then(|name| name.to_str()).expect("a name");
                let mut named = names_below(text, parent);
                if path.starts_with(&folder) {
                    named.extend(names_below(text, "super"));
                }
                assert!(!named.contains(&module), "{} names {module}", path.display());
            }
        }
    }
}

#[test]
fn names_of_groups_and_single_paths_are_found() {
    let text = "use super::{page, hosts::Line};\nuse crate::pages::host;\nlet it = crate::pages::run::show;";
    assert_eq!(names_below(text, "super"), ["page", "hosts"]);
    assert_eq!(names_below(text, "pages"), ["host", "run"]);
}
