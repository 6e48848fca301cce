//! `peernet models`: listing, checking and measuring the models on this machine.

mod bench;
mod check;
mod input;
mod list;
mod loaded_model;
mod show;
mod tally;

use std::path::PathBuf;

use crate::exit::{Exit, Failure};
use crate::foreground::{LogDestination, start_log};
use anyhow::anyhow;
use peernet_inference::bank::{ModelFolders, ModelOnDisk};
use peernet_inference::{CardSummary, LoadError};

/// Arguments of `peernet models`.
#[derive(Debug, clap::Args)]
pub(crate) struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, clap::Subcommand)]
enum Command {
    /// List the models of all folders that are searched.
    List(list::Arguments),
    /// Show a model's card and the hash of its file.
    Show(show::Arguments),
    /// Load a model and run it on zeros, and on its own test pictures if it has any.
    Check(check::Arguments),
    /// Measure the duration of each stage of a model, and its memory.
    Bench(bench::Arguments),
}

/// Executes the subcommand.
///
/// # Errors
/// When the model does not exist (exit code 66), or cannot be used (exit code 69).
pub(crate) fn run(arguments: &Arguments) -> Result<(), Failure> {
    match &arguments.command {
        Command::List(arguments) => list::run(arguments),
        Command::Show(arguments) => show::run(arguments),
        // These commands load a model. The log warns if loading takes long.
        Command::Check(arguments) => {
            start_log(LogDestination::StandardError)?;
            check::run(arguments)
        }
        Command::Bench(arguments) => {
            start_log(LogDestination::StandardError)?;
            bench::run(arguments)
        }
    }
}

/// Folders that are searched for models.
#[derive(Debug, clap::Args)]
struct SearchedFolders {
    /// A folder of models that is searched before PEERNET_MODELS, /var/lib/peernet/models and models; may be given
    /// several times.
    #[arg(long, value_name = "DIR")]
    models_dir: Vec<PathBuf>,
}

impl SearchedFolders {
    fn folders(&self) -> Result<ModelFolders, Failure> {
        if let Some(folder) = self.models_dir.iter().find(|folder| !folder.is_dir()) {
            return Err(Failure::new(Exit::NoInput, anyhow!("there is no folder {}", folder.display())));
        }
        Ok(ModelFolders::search(&self.models_dir))
    }

    fn find(&self, name: &str) -> Result<ModelOnDisk, Failure> {
        self.folders()?.find(name).map_err(failure)
    }
}

/// A model in the searched folders.
#[derive(Debug, clap::Args)]
struct WantedModel {
    /// The name of the model's folder, or a path to it with a slash.
    name: String,
    #[command(flatten)]
    searched: SearchedFolders,
}

impl WantedModel {
    fn find(&self) -> Result<ModelOnDisk, Failure> {
        self.searched.find(&self.name)
    }
}

/// Describes the mismatch if the hash in the card belongs to another file.
fn describe_hash_mismatch(card: &CardSummary, hash: &str) -> Option<String> {
    let (_, card_hash) = card.provenance.iter().find(|(key, _)| key == "sha256")?;
    (card_hash != hash)
        .then(|| format!("the card was written for another model.onnx, of SHA-256 {card_hash}"))
}

fn failure(error: LoadError) -> Failure {
    let exit = match &error {
        LoadError::NotFound { .. } | LoadError::File { .. } => Exit::NoInput,
        LoadError::InvalidDevice(_) | LoadError::AboveLimit { .. } => Exit::Usage,
        _ => Exit::Unavailable,
    };
    Failure::new(exit, error)
}
