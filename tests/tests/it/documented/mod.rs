//! Tests that execute the commands of the documents with the real programs; commands that use a network are executed
//! between two machines.

mod exempt_commands;
mod from_source;
mod language_model;
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
const EXECUTED_COMMANDS: [&[&str]; 10] = [
    &one_machine::COMMANDS,
    &manual_start::COMMANDS,
    &from_source::COMMANDS,
    &language_model::COMMANDS,
    &paper::COMMANDS,
    &pictures::COMMANDS,
    &published::COMMANDS,
    &same_seed::COMMANDS,
    &two_machines::COMMANDS,
    &users::COMMANDS,
];

#[test]
fn every_documented_command_is_executed_by_a_test() {
    let documented: BTreeSet<String> = Document::all().iter().flat_map(Document::commands).collect();
    let unknown: Vec<_> = documented.iter().filter(|command| is_known(command) == Some(false)).collect();
    assert!(
        unknown.is_empty(),
        "targets that the Makefile lacks, or packages that deploy/install-tools.sh lacks: {unknown:#?}"
    );

    let documented: BTreeSet<&str> =
        documented.iter().map(String::as_str).filter(|command| is_known(command).is_none()).collect();
    let executed_elsewhere = EXECUTED_ELSEWHERE.iter().flat_map(|(commands, ..)| *commands).copied();
    let never_executed = NEVER_EXECUTED.iter().flat_map(|(_, commands)| *commands).copied();
    let executed: BTreeSet<&str> =
        EXECUTED_COMMANDS.concat().into_iter().chain(executed_elsewhere).chain(never_executed).collect();
    let untested: Vec<_> = documented.difference(&executed).collect();
    assert!(untested.is_empty(), "no test executes these commands of the documents: {untested:#?}");
    let undocumented: Vec<_> = executed.difference(&documented).collect();
    assert!(
        undocumented.is_empty(),
        "no document shows these commands that tests execute: {undocumented:#?}"
    );
}
