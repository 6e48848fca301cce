//! Tests of the documents: examples pass the check, every key is described, and links lead to existing targets.
//!
//! A TOML block whose first line is a comment with a bare file name, `# edge.toml`, is a complete file, which must
//! pass `peernetd check` in a folder with links to folders of the checkout and with the built example in C. A block
//! with the tables `[experiment]` and `[pipeline]` is an experiment, which must pass `peernet run --check` in the root
//! of the checkout. Any other TOML block is an excerpt.

use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};

use peernet_tests::{Document, LoopbackDeployment, Process, onnxruntime, program, root};

use crate::external::build_example;

const REFERENCE: &str = "docs/configuration.md";

/// Returns the file name of a block that is a complete file.
fn complete_file_name(block: &str) -> Option<&str> {
    let name = block.lines().next()?.strip_prefix("# ")?;
    (name.ends_with(".toml") && !name.contains([' ', '/'])).then_some(name)
}

/// Returns whether a block is the complete file of an experiment.
fn is_experiment(block: &str) -> bool {
    let tables: Result<toml::Table, _> = toml::from_str(block);
    tables.is_ok_and(|tables| ["experiment", "pipeline"].iter().all(|name| tables.contains_key(*name)))
}

#[test]
fn experiments_in_the_documents_pass_the_check() {
    let deployment = LoopbackDeployment::new();
    let mut checked_documents = Vec::new();
    for document in Document::all() {
        for (line, block) in
            document.fenced_blocks("toml").into_iter().filter(|(_, block)| is_experiment(block))
        {
            let file = deployment.write("experiment.toml", &block);
            let arguments = [Path::new("run"), Path::new("--check"), &file];
            let end = Process::start(&program("peernet"), &arguments, root(), &[]).wait_for_end();
            assert_eq!(end.code(), 0, "{}:{line}:\n{}", document.path.display(), end.log);
            checked_documents.push(document.path.clone());
        }
    }
    assert!(
        checked_documents.contains(&PathBuf::from("docs/experiments.md")),
        "docs/experiments.md has no complete experiment: {checked_documents:?}"
    );
}

#[test]
fn complete_examples_pass_check_and_excerpts_parse() {
    let deployment = LoopbackDeployment::new();
    // The examples name the folder `onnxruntime`. This call panics if the library is missing.
    let _needed = onnxruntime();
    for name in ["configs", "docs", "models", "onnxruntime"] {
        symlink(root().join(name), deployment.folder().join(name)).expect("the temporary folder is writable");
    }
    build_example(deployment.folder());
    let mut problems = Vec::new();
    for document in Document::all() {
        for (line, block) in document.fenced_blocks("toml") {
            let position = format!("{}:{line}", document.path.display());
            let Some(name) = complete_file_name(&block).filter(|_| !is_experiment(&block)) else {
                if let Err(error) = toml::from_str::<toml::Table>(&block) {
                    problems.push(format!("{position}: {error}"));
                }
                continue;
            };
            // The check binds this port, and a demo may be running.
            let block = block.replace("tcp://127.0.0.1:5551", "tcp://127.0.0.1:{data}");
            deployment.write(name, &block);
            let end = Process::start(&program("peernetd"), &["check", name], deployment.folder(), &[])
                .wait_for_end();
            if end.code() != 0 {
                problems.push(format!("{position}:\n{}", end.log));
            }
        }
    }
    assert!(problems.is_empty(), "{}", problems.join("\n"));

    let reference = Document::read(REFERENCE).fenced_blocks("toml");
    assert!(!reference.is_empty(), "{REFERENCE} has no example");
    for (line, block) in reference {
        assert!(
            complete_file_name(&block).is_some(),
            "{REFERENCE}:{line}: the example is not a complete file"
        );
    }
}

#[test]
fn links_lead_to_files_and_sections_that_exist() {
    let mut broken_links = Vec::new();
    for document in Document::all() {
        let folder = document.path.parent().expect("a file is in a folder");
        for (line, target) in document.links() {
            if target.contains("://") || target.starts_with("mailto:") {
                continue;
            }
            let (file, section) = target.split_once('#').unwrap_or((target, ""));
            let path = if file.is_empty() { document.path.clone() } else { folder.join(file) };
            let exists = root().join(&path).exists()
                && (section.is_empty() || Document::read(&path).anchors().iter().any(|name| name == section));
            if !exists {
                broken_links.push(format!("{}:{line}: {target}", document.path.display()));
            }
        }
    }
    assert!(broken_links.is_empty(), "links that lead nowhere:\n{}", broken_links.join("\n"));
}

/// Sections of the reference, each with a file that has a key or value `zz` where the section describes keys or
/// values.
const UNKNOWN_NAMES: [(&str, &str); 31] = [
    ("configuration", "zz = 1"),
    ("log", "[log]\nzz = 1"),
    ("lifecycle", "[lifecycle]\nzz = 1"),
    ("aggregator", "[aggregator]\nzz = 1"),
    ("aggregatorretention", "[aggregator.retention]\nzz = 1"),
    ("web", "[web]\nzz = 1"),
    ("webwarn", "[web.warn]\nzz = 1"),
    ("agent", "[agent]\nzz = 1"),
    ("spool", "[spool]\nzz = 1"),
    ("spool", "[spool]\ncompression = \"zz\""),
    ("clock", "[clock]\nzz = 1"),
    ("clock", "[clock]\ntimestamps = \"zz\""),
    ("clock", "[clock]\ndiscipline = [\"zz\"]"),
    ("probes", "[probes]\nzz = 1"),
    ("clock_fault", "[clock_fault]\nzz = 1"),
    ("clock_fault", "[clock_fault]\nsteps = [{ zz = 1 }]"),
    ("clock_fault", "[clock_fault]\ndiscipline = \"zz\""),
    ("serve", "[serve]\nzz = 1"),
    ("serve", "[serve]\nnetwork = \"zz\""),
    ("session", "[serve.session]\nzz = 1"),
    ("session", "[serve.session.ros2]\nzz = 1"),
    ("session", "[serve.session.ros2]\nreliability = \"zz\""),
    ("onnxruntime", "[onnxruntime]\nzz = 1"),
    ("pipeline", "[[pipeline]]\nzz = 1"),
    ("pipeline", "[[pipeline]]\nstart = \"zz\""),
    ("sensor", "[[pipeline]]\nsensor = { kind = \"images\", path = \"\", order = \"zz\" }"),
    (
        "transforms",
        "[[pipeline]]\ntransforms = [{ kind = \"resize\", width = 1, height = 1, filter = \"zz\" }]",
    ),
    ("transforms", "[[pipeline]]\ntransforms = [{ kind = \"encode\", format = \"zz\" }]"),
    ("warm-up", "[[pipeline]]\nwarm_up = { zz = 1 }"),
    ("limit", "[[pipeline]]\nlimit = { zz = 1 }"),
    ("actuator", "[[pipeline]]\nactuator = { kind = \"zz\" }"),
];

/// The same as [`UNKNOWN_NAMES`] for experiments.
const UNKNOWN_NAMES_OF_EXPERIMENTS: [(&str, &str); 4] = [
    ("experiment", "[experiment]\nzz = 1\n[pipeline]"),
    ("pipeline-and-the-agents-tables", "[experiment]\nname = 'e'\n[pipeline]\n[network]\nzz = 1"),
    ("axis", "[experiment]\nname = 'e'\n[pipeline]\n[[axis]]\nzz = 1"),
    ("axis", "[experiment]\nname = 'e'\n[pipeline]\n[[axis]]\nname = 'a'\n[[axis.value]]\nzz = 1"),
];

/// The same as [`UNKNOWN_NAMES`] for tables whose keys depend on their kind, which replaces `KIND`.
const UNKNOWN_NAMES_OF_KINDS: [(&str, &str); 6] = [
    ("model", "[[model]]\nname = \"m\"\nkind = \"KIND\"\nzz = 1"),
    ("sensor", "[[pipeline]]\nsensor = { kind = \"KIND\", zz = 1 }"),
    ("transforms", "[[pipeline]]\ntransforms = [{ kind = \"KIND\", zz = 1 }]"),
    ("actuator", "[[pipeline]]\nactuator = { kind = \"KIND\", zz = 1 }"),
    ("placement", "[[pipeline]]\nplacement = { kind = \"KIND\", zz = 1 }"),
    ("load", "[[pipeline]]\nload = { mode = \"KIND\", zz = 1 }"),
];

/// Runs a program's check on a file; returns the output.
type Check = fn(&LoopbackDeployment, &str) -> String;

fn check_configuration(deployment: &LoopbackDeployment, file: &str) -> String {
    deployment.write("unknown.toml", file);
    deployment.peernetd(&["check", "unknown.toml"]).wait_for_end().log
}

fn check_experiment(deployment: &LoopbackDeployment, file: &str) -> String {
    deployment.write("unknown.toml", file);
    let arguments = ["run", "--check", "unknown.toml"];
    Process::start(&program("peernet"), &arguments, deployment.folder(), &[]).wait_for_end().log
}

/// Returns the names that a check offers instead of `zz`.
fn offered_names(output: &str) -> Vec<String> {
    let messages = ["unknown field `zz`, ", "unknown variant `zz`, "];
    let known = messages.iter().find_map(|message| output.split_once(message));
    let (_, known) = known.unwrap_or_else(|| panic!("the check does not name zz:\n{output}"));
    known.lines().take(1).flat_map(|known| known.split('`').skip(1).step_by(2)).map(str::to_owned).collect()
}

/// Returns the words that a section does not contain.
fn undocumented_words(document: &Document, section: &str, words: &[String]) -> Vec<String> {
    let text = document.section(section);
    let is_described = |word: &str| {
        ["`WORD`", "\"WORD\"", "[WORD]"].iter().any(|form| text.contains(&form.replace("WORD", word)))
    };
    let undocumented = words.iter().filter(|word| !is_described(word));
    undocumented.map(|word| format!("{} {section}: {word}", document.path.display())).collect()
}

#[test]
fn reference_describes_every_key_and_kind() {
    let deployment = LoopbackDeployment::new();
    let mut missing = Vec::new();
    let mut collect_missing = |document: &str, check: Check, files: &[(&str, &str)]| {
        let document = Document::read(document);
        for (section, file) in files {
            missing.extend(undocumented_words(&document, section, &offered_names(&check(&deployment, file))));
        }
    };
    collect_missing(REFERENCE, check_configuration, &UNKNOWN_NAMES);
    collect_missing("docs/experiments.md", check_experiment, &UNKNOWN_NAMES_OF_EXPERIMENTS);
    let reference = Document::read(REFERENCE);
    for (section, file) in UNKNOWN_NAMES_OF_KINDS {
        let names_offered_for =
            |kind: &str| offered_names(&check_configuration(&deployment, &file.replace("KIND", kind)));
        // For an unknown kind the check offers the kinds, and for a known kind it offers the keys.
        let kinds = names_offered_for("zz");
        missing.extend(undocumented_words(&reference, section, &kinds));
        missing.extend(
            kinds.iter().flat_map(|kind| undocumented_words(&reference, section, &names_offered_for(kind))),
        );
    }
    assert!(missing.is_empty(), "the documents do not describe:\n{}", missing.join("\n"));
}
