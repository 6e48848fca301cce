//! `peernet models check`: loads a model and compares its answers with the labels of test pictures.

use std::path::PathBuf;

use crate::exit::{Exit, Failure};
use crate::output::{print_to_stderr, print_to_stdout};
use anyhow::anyhow;
use peernet_statistics::number::{counted, fixed};

use super::input::Input;
use super::loaded_model::{LoadedModel, Options};
use super::tally::{Tally, describe};
use super::{WantedModel, describe_hash_mismatch, failure};

/// Arguments of `peernet models check`.
#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    #[command(flatten)]
    model: WantedModel,
    #[command(flatten)]
    options: Options,
    /// A picture, or a folder of pictures with or without a labels.csv, instead of the model's own pictures.
    #[arg(long, value_name = "PATH")]
    pictures: Option<PathBuf>,
}

pub(super) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let model = arguments.model.find()?;
    // The mismatch is reported first, because it may be the reason why the model does not load.
    if let Ok(card) = &model.card
        && let Some(text) = describe_hash_mismatch(card, &model.hash().map_err(failure)?)
    {
        print_to_stderr(text);
    }
    let mut tally = Tally::default();
    let loaded_model = LoadedModel::load(&model, &arguments.options)?;
    let pool = loaded_model.pool();
    print_to_stdout(format_args!(
        "loaded on {} in {} s and run on zeros",
        pool.device(),
        fixed(pool.load_duration().seconds(), 2)
    ));
    let Some(input) = Input::pictures(&model, arguments.pictures.as_deref(), loaded_model.clock())? else {
        print_to_stdout(
            "no test pictures: the model's folder has no `pictures`, and --pictures was not given",
        );
        return Ok(());
    };
    let all = input.samples.len() as u64;
    let is_single = all == 1;
    let mut failed = 0;
    for sample in input.samples {
        let (source, label) = (sample.source.clone(), sample.label.clone());
        let (answer, measurements) = loaded_model.infer(sample);
        match answer {
            Err(error) => {
                print_to_stderr(error);
                failed += 1;
            }
            Ok(answer) => {
                if let Some(label) = label {
                    tally
                        .add(&label, &answer, &measurements)
                        .map_err(|error| Failure::new(Exit::NoInput, error))?;
                }
                if is_single {
                    print_to_stdout(format_args!("{source}: {}", describe(&answer)));
                }
            }
        }
    }
    let answered_prefix = if failed > 0 { format!("{} of ", all - failed) } else { String::new() };
    print_to_stdout(format_args!("answered {answered_prefix}{}{}", input.description, tally.text()));
    if failed > 0 {
        let verb = if failed == 1 { "was" } else { "were" };
        let error = anyhow!("{} {verb} not answered; the lines above say why", counted(failed, "picture"));
        return Err(Failure::new(Exit::Unavailable, error));
    }
    Ok(())
}
