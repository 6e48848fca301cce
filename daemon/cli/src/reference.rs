//! A check that the tables in `docs/cli.md` are those generated from the command line's help.

use std::fmt::Write;
use std::path::Path;

use clap::{Arg, ArgAction, Command, CommandFactory};

use crate::Cli;

/// Path of the document from the root of the checkout.
const FILE: &str = "docs/cli.md";
/// Line above the generated part.
const MARK: &str = "<!-- The rest of this file is generated from the program's help texts: PEERNET_WRITE_DOCS=1 cargo test -p peernet-cli reference -->\n";
/// Options that every command has, which the document leaves out.
const IMPLICIT_OPTIONS: [&str; 2] = ["help", "version"];

#[test]
fn command_line_is_well_formed() {
    Cli::command().debug_assert();
}

#[test]
fn reference_matches_help_of_program() {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..").join(FILE);
    let text = std::fs::read_to_string(&file).expect("the checkout has the document");
    let (text_before_mark, committed_reference) = text.split_once(MARK).expect("the document has the mark");
    let generated = reference();
    if std::env::var_os("PEERNET_WRITE_DOCS").is_some() {
        std::fs::write(&file, format!("{text_before_mark}{MARK}{generated}"))
            .expect("the checkout can be written to");
    } else {
        assert!(
            committed_reference == generated,
            "{FILE} is out of date: run PEERNET_WRITE_DOCS=1 cargo test -p peernet-cli reference"
        );
    }
}

/// Returns the text of all commands, one section each.
fn reference() -> String {
    let mut command = Cli::command();
    command.build();
    let mut text = String::new();
    write_section(&mut text, &command, "peernet");
    text
}

fn write_section(text: &mut String, command: &Command, path: &str) {
    let level = "#".repeat(1 + path.split(' ').count());
    let about = command.get_long_about().or(command.get_about()).map(ToString::to_string);
    let _ = write!(text, "\n{level} `{path}`\n\n{}.\n", about.unwrap_or_default().trim_end_matches('.'));
    let is_shown = |arg: &&Arg| !arg.is_hide_set() && !IMPLICIT_OPTIONS.contains(&arg.get_id().as_str());
    let arguments: Vec<&Arg> = command.get_arguments().filter(is_shown).collect();
    if !arguments.is_empty() {
        text.push_str("\n| argument | what | default |\n| --- | --- | --- |\n");
        arguments.into_iter().for_each(|argument| write_row(text, argument));
    }
    let commands = command.get_subcommands();
    for subcommand in
        commands.filter(|subcommand| !subcommand.is_hide_set() && subcommand.get_name() != "help")
    {
        write_section(text, subcommand, &format!("{path} {}", subcommand.get_name()));
    }
}

fn write_row(text: &mut String, argument: &Arg) {
    let takes_value =
        !matches!(argument.get_action(), ArgAction::SetTrue | ArgAction::Count | ArgAction::SetFalse);
    let values: Vec<String> =
        argument.get_value_names().unwrap_or_default().iter().map(|name| format!("<{name}>")).collect();
    let name = match argument.get_long() {
        Some(long) if takes_value => format!("--{long} {}", values.join(" ")),
        Some(long) => format!("--{long}"),
        None => values.join(" "),
    };
    let short = argument.get_short().map(|short| format!("`-{short}`, ")).unwrap_or_default();
    let help = argument.get_long_help().or(argument.get_help()).map(ToString::to_string).unwrap_or_default();
    let help = format!("{help}{}", if takes_value { possible_values(argument) } else { String::new() });
    let help = help.split_whitespace().collect::<Vec<_>>().join(" ").replace('|', "\\|");
    let default: Vec<_> = argument.get_default_values().iter().map(|value| value.to_string_lossy()).collect();
    let variable = argument.get_env().map(|name| format!("`${}`", name.to_string_lossy()));
    let default = (!default.is_empty() && takes_value).then(|| format!("`{}`", default.join(" ")));
    let default = match (variable, default) {
        (None, None) if argument.is_required_set() => "required".to_owned(),
        (variable, default) => variable.into_iter().chain(default).collect::<Vec<_>>().join(", else "),
    };
    let name = name.replace('|', "\\|");
    let _ = writeln!(text, "| {short}`{name}` | {help} | {default} |");
}

/// Returns the possible values of an argument, if it has a list of them.
fn possible_values(argument: &Arg) -> String {
    let values = argument.get_possible_values();
    let values = values.iter().filter(|value| !value.is_hide_set()).map(|value| match value.get_help() {
        Some(help) => format!("`{}` ({help})", value.get_name()),
        None => format!("`{}`", value.get_name()),
    });
    let values: Vec<String> = values.collect();
    if values.is_empty() { String::new() } else { format!(": {}", values.join(", ")) }
}
