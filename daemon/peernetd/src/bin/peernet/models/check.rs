//! `peernet models check`

use std::path::PathBuf;

use anyhow::anyhow;
use peernet_report::number::fixed;
use peernet_sample::Sample;
use peernetd::exit::{Exit, Failure};
use peernetd::output::{complain, say};
use serde::Deserialize;

use super::input::Input;
use super::running::{Options, Running};
use super::{Wanted, failure, other_file};

/// What `peernet models check` can be told.
#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    #[command(flatten)]
    wanted: Wanted,
    #[command(flatten)]
    options: Options,
    /// A picture, or a folder of pictures with or without a labels.csv, in the place of the model's own.
    #[arg(long, value_name = "PATH")]
    pictures: Option<PathBuf>,
}

/// A classifier's answer, as far as it matters here.
#[derive(Deserialize)]
struct Answer {
    label: String,
    score: f64,
}

pub(super) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let found = arguments.wanted.find()?;
    if let Ok(card) = &found.card
        && let Some(text) = other_file(card, &found.hash().map_err(failure)?)
    {
        complain(text);
    }
    let labels = found.card.as_ref().map(|card| card.labels.clone()).unwrap_or_default();
    let running = Running::load(&found, &arguments.options)?;
    let pool = running.pool();
    say(format_args!(
        "loaded on {} in {} s and run on zeros",
        pool.device(),
        fixed(pool.loaded_in().seconds(), 2)
    ));
    let Some(input) = Input::pictures(&found, arguments.pictures.as_deref(), running.clock())? else {
        say("no test pictures: none in its folder `pictures`, none named with --pictures");
        return Ok(());
    };
    let (mut right, mut labelled, mut failed) = (0, 0, 0);
    let alone = input.samples.len() == 1;
    for sample in input.samples {
        let (source, label) = (sample.source.clone(), sample.label.clone());
        let answer =
            running.infer(sample).0.map_err(|error| error.to_string()).and_then(|answer| read(&answer));
        match answer {
            Err(reason) => {
                complain(reason);
                failed += 1;
            }
            Ok(answer) => {
                // Labels that the model does not know belong to another one's pictures.
                if let Some(label) = label.filter(|label| labels.contains(label)) {
                    labelled += 1;
                    right += usize::from(label == answer.label);
                }
                if alone {
                    say(format_args!("{source}: {} ({})", answer.label, fixed(answer.score, 3)));
                }
            }
        }
    }
    let accuracy = if labelled > 0 { format!("; {right} of {labelled} labels right") } else { String::new() };
    say(format_args!("answered {}{accuracy}", input.what));
    if failed > 0 {
        let error = anyhow!("{failed} pictures were not answered; the lines above say why");
        return Err(Failure::new(Exit::Unavailable, error));
    }
    Ok(())
}

fn read(answer: &Sample) -> Result<Answer, String> {
    let bytes = answer.parts.first().map(|part| part.bytes.as_ref()).unwrap_or_default();
    serde_json::from_slice(bytes).map_err(|error| format!("its answer cannot be read: {error}"))
}
