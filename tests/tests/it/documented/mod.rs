//! Tests that execute the commands of the documents with the real programs; commands that use a network are executed
//! between two machines.

mod exempt_commands;
mod from_source;
mod manual_start;
mod one_machine;
mod paper;
mod pictures;
mod published;
pub(crate) mod two_machines;

use std::collections::BTreeSet;

use peernet_tests::Document;

use crate::experiments::{same_seed, users};
use exempt_commands::{EXECUTED_ELSEWHERE, NEVER_EXECUTED, is_known};

/// Commands that these tests and those of experiments execute.
const EXECUTED_COMMANDS: [&[&str]; 9] = [
    &one_machine::COMMANDS,
    &manual_start::COMMANDS,
    &from_source::COMMANDS,
    &paper::COMMANDS,
    &pictures::COMMANDS,
    &published::COMMANDS,
    &same_seed::COMMANDS,
    &two_machines::COMMANDS,
    &users::COMMANDS,
];

#[test]
fn every_documented_command_is_executed_by_a_test() {
    let shown: BTreeSet<String> = Document::all().iter().flat_map(Document::commands).collect();
    let unknown: Vec<_> = shown.iter().filter(|command| is_known(command) == Some(false)).collect();
    assert!(
        unknown.is_empty(),
        "targets that the Makefile lacks, or packages that its tools lack: {unknown:#?}"
    );

    let shown: BTreeSet<&str> =
        shown.iter().map(String::as_str).filter(|it| is_known(it).is_none()).collect();
    let elsewhere = EXECUTED_ELSEWHERE.iter().flat_map(|(commands, ..)| *commands).copied();
    let nowhere = NEVER_EXECUTED.iter().flat_map(|(_, commands)| *commands).copied();
    let run: BTreeSet<&str> =
        EXECUTED_COMMANDS.concat().into_iter().chain(elsewhere).chain(nowhere).collect();
    let forgotten: Vec<_> = shown.difference(&run).collect();
    assert!(forgotten.is_empty(), "no test executes these commands of the documents: {forgotten:#?}");
    let gone: Vec<_> = run.difference(&shown).collect();
    assert!(gone.is_empty(), "no document shows these commands that tests execute: {gone:#?}");
}
