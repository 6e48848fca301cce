//! Adds the commit to `--version`: from the environment (packagers), otherwise from git, otherwise none. `-dirty` means that the
//! sources of the program differ from the commit.

use std::path::PathBuf;
use std::process::Command;

/// Sources of the program, from the top of the repository. Tests and documents do not change it.
const PARTS: [&str; 9] = [
    "Cargo.toml",
    "Cargo.lock",
    "daemon/*/Cargo.toml",
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
    for name in ["HEAD", "logs/HEAD"] {
        if let Some(path) = git(&["rev-parse", "--git-path", name]) {
            println!("cargo::rerun-if-changed={path}");
        }
    }
    for path in parts() {
        println!("cargo::rerun-if-changed={}", path.display());
    }
    let commit = std::env::var("PEERNET_COMMIT").ok().or_else(commit);
    println!("cargo::rustc-env=PEERNET_COMMIT={}", commit.as_deref().unwrap_or("commit unknown"));
}

fn commit() -> Option<String> {
    let head = git(&["rev-parse", "--short=10", "HEAD"])?;
    let parts = PARTS.map(|part| format!(":(top,glob){part}{}", if part.contains('.') { "" } else { "/**" }));
    let question = ["--no-optional-locks", "status", "--porcelain", "--untracked-files=no", "--"];
    let question: Vec<&str> = question.into_iter().chain(parts.iter().map(String::as_str)).collect();
    Some(if git(&question).is_some() { format!("{head}-dirty") } else { head })
}

/// Returns the existing parts of the checkout. A change in a part can make the commit dirty, or clean again.
fn parts() -> Vec<PathBuf> {
    let top = PathBuf::from("../..");
    let crates = std::fs::read_dir(top.join("daemon")).into_iter().flatten().filter_map(Result::ok);
    let crates: Vec<PathBuf> = crates.map(|entry| entry.path()).collect();
    let of = |part: &str| match part.strip_prefix("daemon/*/") {
        Some(below) => crates.iter().map(|folder| folder.join(below)).collect(),
        None => vec![top.join(part)],
    };
    PARTS.iter().flat_map(|part| of(part)).filter(|path| path.exists()).collect()
}

fn git(arguments: &[&str]) -> Option<String> {
    let output =
        Command::new("git").args(arguments).output().ok().filter(|output| output.status.success())?;
    Some(String::from_utf8(output.stdout).ok()?.trim().to_owned()).filter(|text| !text.is_empty())
}
