//! `peernet measure`: one order in a process of its own.

use std::io::Read;
use std::path::{Path, PathBuf};

use crate::exit::{Exit, Failure};
use crate::output::{complain, say};
use crate::small_file;
use anyhow::{Context, anyhow};
use rustix::process::{Signal, set_parent_process_death_signal};

use super::{Order, Seen, Watcher, measure};
use crate::foreground::{Shows, listen};

/// What `peernet measure` can be told.
#[derive(Debug, clap::Args)]
pub(crate) struct Arguments {
    /// File with the order, as JSON; `-` is standard input.
    #[arg(long)]
    order: PathBuf,
}

/// Executes the order; says in lines of JSON how far it is, and in texts what users' own code prints.
///
/// # Errors
/// Those of [`measure`], and when the order cannot be read (66) or understood (78), `PEERNET_LOG` is no level (78), or iterations have no answer (75).
pub(crate) fn run(arguments: &Arguments) -> Result<(), Failure> {
    end_with_parent();
    listen(Shows::Parent)?;
    let text = read(&arguments.order).map_err(|error| Failure::new(Exit::NoInput, error))?;
    let order: Order = serde_json::from_str(&text).map_err(|error| {
        Failure::new(Exit::Configuration, anyhow!("cannot understand the order: {error}"))
    })?;
    let measured = measure(&order, &mut Lines)?;
    measured.failure().map_or(Ok(()), Err)
}

/// A run whose experiment was killed must not write into a folder that is given to another run.
fn end_with_parent() {
    if let Err(error) = set_parent_process_death_signal(Some(Signal::KILL)) {
        complain(format_args!("this run may outlive its experiment: {error}"));
    }
}

fn read(file: &Path) -> anyhow::Result<String> {
    if file == Path::new("-") {
        let mut text = String::new();
        std::io::stdin().read_to_string(&mut text).context("cannot read the order from standard input")?;
        return Ok(text);
    }
    small_file::read(file, small_file::LARGEST)
        .with_context(|| format!("cannot read the order {}", file.display()))
}

/// Writes what is seen to standard output.
struct Lines;

impl Watcher for Lines {
    fn look(&mut self, seen: &Seen) {
        match serde_json::to_string(seen) {
            Ok(line) => say(line),
            // Numbers that JSON has no word for; the next look tells more.
            Err(error) => tracing::debug!(%error, "a look cannot be written"),
        }
    }
}
