//! Adds the commit to `--version`: the commit in `PEERNET_COMMIT`, which packagers set, otherwise the commit of the git
//! checkout, otherwise the text `commit unknown`. `-dirty` means that the sources of the program differ from the
//! commit.

use std::path::PathBuf;
use std::process::Command;

/// Sources of the program, from the top of the repository. Tests and documents do not change the program.
const SOURCES: [&str; 11] = [
    "Cargo.toml",
    "Cargo.lock",
    "daemon/*/Cargo.toml",
    "daemon/*/build.rs",
    "daemon/*/assets",
    "daemon/*/src",
    "migrations",
    "web/Cargo.toml",
    "web/askama.toml",
    "web/assets",
    "web/src",
];

fn main() {
    println!("cargo::rerun-if-env-changed=PEERNET_COMMIT");
    println!("cargo::rerun-if-changed=build.rs");
    // Each new commit and each switch to another commit changes one of these files of git.
    for name in ["HEAD", "logs/HEAD"] {
        if let Some(path) = git(&["rev-parse", "--git-path", name]) {
            println!("cargo::rerun-if-changed={path}");
        }
    }
    for path in source_paths() {
        println!("cargo::rerun-if-changed={}", path.display());
    }
    let commit = std::env::var("PEERNET_COMMIT").ok().or_else(commit);
    println!("cargo::rustc-env=PEERNET_COMMIT={}", commit.as_deref().unwrap_or("commit unknown"));
}

/// Returns the short hash of the commit, with `-dirty` if a source of the program is changed.
fn commit() -> Option<String> {
    let head = git(&["rev-parse", "--short=10", "HEAD"])?;
    // A source with a dot in its path is a file. The others are folders, of which all files count.
    let pathspecs =
        SOURCES.map(|source| format!(":(top,glob){source}{}", if source.contains('.') { "" } else { "/**" }));
    let status = ["--no-optional-locks", "status", "--porcelain", "--untracked-files=no", "--"];
    let status: Vec<&str> = status.into_iter().chain(pathspecs.iter().map(String::as_str)).collect();
    // `git status --porcelain` prints nothing if no source is changed, and `git` returns `None` for empty output.
    Some(if git(&status).is_some() { format!("{head}-dirty") } else { head })
}

/// Returns the paths of the sources that exist in the checkout. A change of a source can make the commit dirty, or
/// clean again.
fn source_paths() -> Vec<PathBuf> {
    let top = PathBuf::from("../..");
    let crates = std::fs::read_dir(top.join("daemon")).into_iter().flatten().filter_map(Result::ok);
    let crates: Vec<PathBuf> = crates.map(|entry| entry.path()).collect();
    let paths_of = |source: &str| match source.strip_prefix("daemon/*/") {
        Some(below) => crates.iter().map(|folder| folder.join(below)).collect(),
        None => vec![top.join(source)],
    };
    SOURCES.iter().flat_map(|source| paths_of(source)).filter(|path| path.exists()).collect()
}

/// Returns the output of a git command; `None` if the command fails or prints nothing.
fn git(arguments: &[&str]) -> Option<String> {
    let output =
        Command::new("git").args(arguments).output().ok().filter(|output| output.status.success())?;
    Some(String::from_utf8(output.stdout).ok()?.trim().to_owned()).filter(|text| !text.is_empty())
}
