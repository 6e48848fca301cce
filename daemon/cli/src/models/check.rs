//! `peernet models check`

use std::collections::HashSet;
use std::path::PathBuf;

use crate::exit::{Exit, Failure};
use crate::output::{print_to_stderr, print_to_stdout};
use anyhow::anyhow;
use peernet_inference::InferenceError;
use peernet_sample::{Sample, normalized_label};
use peernet_statistics::number::{counted, fixed};
use serde::Deserialize;

use super::input::Input;
use super::running::{LoadedModel, Options};
use super::{WantedModel, describe_hash_mismatch, failure};

/// Arguments of `peernet models check`.
#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    #[command(flatten)]
    wanted: WantedModel,
    #[command(flatten)]
    options: Options,
    /// A picture, or a folder of pictures with or without a labels.csv, instead of the model's own.
    #[arg(long, value_name = "PATH")]
    pictures: Option<PathBuf>,
}

/// Parts of a classifier's answer that the check needs.
#[derive(Deserialize)]
struct Answer {
    label: String,
    score: f64,
}

pub(super) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let model = arguments.wanted.find()?;
    if let Ok(card) = &model.card
        && let Some(text) = describe_hash_mismatch(card, &model.hash().map_err(failure)?)
    {
        print_to_stderr(text);
    }
    let classes = model.card.as_ref().map(|card| card.labels.as_slice()).unwrap_or_default();
    let classes: HashSet<String> = classes.iter().map(|class| normalized_label(class)).collect();
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
    let (mut correct, mut labelled, mut unknown_labels, mut failed) = (0, 0, 0, 0);
    let all = input.samples.len() as u64;
    let is_single = all == 1;
    for sample in input.samples {
        let (source, label) = (sample.source.clone(), sample.label.clone());
        let answer = loaded_model.infer(sample).0.map_err(AnswerError::from).and_then(|answer| read(&answer));
        match answer {
            Err(error) => {
                print_to_stderr(error);
                failed += 1;
            }
            Ok(answer) => {
                match label.map(|label| normalized_label(&label)) {
                    Some(label) if classes.contains(&label) => {
                        labelled += 1;
                        correct += usize::from(label == normalized_label(&answer.label));
                    }
                    // The label is not a class of the model, so no answer could be right.
                    Some(_) => unknown_labels += 1,
                    None => {}
                }
                if is_single {
                    print_to_stdout(format_args!("{source}: {} ({})", answer.label, fixed(answer.score, 3)));
                }
            }
        }
    }
    let accuracy =
        if labelled > 0 { format!("; {correct} of {labelled} labels right") } else { String::new() };
    let unknown = match unknown_labels {
        0 => String::new(),
        1 => "; 1 label is not a class of the model".to_owned(),
        count => format!("; {count} labels are not classes of the model"),
    };
    let answered_count = if failed > 0 { format!("{} of ", all - failed) } else { String::new() };
    print_to_stdout(format_args!("answered {answered_count}{}{accuracy}{unknown}", input.description));
    if failed > 0 {
        let verb = if failed == 1 { "was" } else { "were" };
        let error = anyhow!("{} {verb} not answered; the lines above say why", counted(failed, "picture"));
        return Err(Failure::new(Exit::Unavailable, error));
    }
    Ok(())
}

/// Reason for which a picture has no answer.
#[derive(Debug, thiserror::Error)]
enum AnswerError {
    #[error(transparent)]
    Inference(#[from] InferenceError),
    #[error("its answer cannot be read: {0}")]
    Unreadable(#[from] serde_json::Error),
}

fn read(answer: &Sample) -> Result<Answer, AnswerError> {
    let bytes = answer.parts.first().map(|part| part.bytes.as_ref()).unwrap_or_default();
    Ok(serde_json::from_slice(bytes)?)
}
