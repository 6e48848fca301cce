//! `peernet models bench`: measures the duration of each stage of a model, and its memory.

use std::num::NonZeroU64;
use std::path::PathBuf;

use crate::exit::{Exit, Failure};
use crate::output::print_to_stdout;
use peernet_analysis::order::SortedValues;
use peernet_analysis::table::text;
use peernet_inference::ProcessMemory;
use peernet_logger::Tree;
use peernet_statistics::number::{NONE, bytes, counted, milliseconds};
use serde_json::{Value, json};

use super::WantedModel;
use super::input::Input;
use super::loaded_model::{LoadedModel, Options};
use crate::foreground::Progress;

/// Stages of a model, in their order.
const STAGES: [&str; 3] = ["preprocessing", "inference", "postprocessing"];
/// Name of a quantile, and the function that returns it.
type NamedQuantile = (&'static str, fn(&SortedValues) -> Option<f64>);

/// Reported quantiles.
const QUANTILES: [NamedQuantile; 3] =
    [("p50", SortedValues::median), ("p95", SortedValues::p95), ("p99", SortedValues::p99)];

/// Arguments of `peernet models bench`.
#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    #[command(flatten)]
    model: WantedModel,
    #[command(flatten)]
    options: Options,
    /// Number of measured samples; p95 needs at least 60 samples, p99 at least 300.
    #[arg(long, value_name = "N", default_value = "300")]
    iterations: NonZeroU64,
    /// Number of warm-up samples before the measured samples.
    #[arg(long, value_name = "N", default_value = "10")]
    warm_up: u64,
    /// A picture or a folder of pictures, used in turn [default: the model's own pictures, otherwise generated pixels].
    #[arg(long, value_name = "PATH")]
    pictures: Option<PathBuf>,
    /// Print JSON, in seconds and bytes.
    #[arg(long)]
    json: bool,
    /// Do not show the progress.
    #[arg(long, short)]
    quiet: bool,
}

/// Measurements, in seconds and bytes.
struct BenchResults {
    device: String,
    input: String,
    load_s: f64,
    /// Durations of each stage, and of the whole call under the name `all`.
    stages: Vec<(&'static str, SortedValues)>,
    /// Memory of the whole process before the model was loaded, and at the end.
    memory: [Option<u64>; 2],
    /// Largest memory of the process.
    peak: Option<u64>,
}

pub(super) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let model = arguments.model.find()?;
    // Read before the model is loaded: the difference to the later value is the memory of the model and of its input.
    let memory_before = ProcessMemory::read();
    let loaded_model = LoadedModel::load(&model, &arguments.options)?;
    let input = Input::pictures(&model, arguments.pictures.as_deref(), loaded_model.clock())?;
    // A model without test pictures can be measured, too; accuracy is not measured here.
    let input = match input.filter(|input| !input.samples.is_empty()) {
        Some(input) => input,
        None => Input::generated(&model)?,
    };
    let stages = measure(arguments, &loaded_model, &input)?;
    let memory = ProcessMemory::read();
    let resident = |memory: ProcessMemory| memory.resident;
    let results = BenchResults {
        device: loaded_model.pool().device(),
        input: input.description,
        load_s: loaded_model.pool().load_duration().seconds(),
        stages,
        memory: [memory_before.map(resident), memory.map(resident)],
        peak: memory.map(|memory| memory.peak),
    };
    if arguments.json {
        print_to_stdout(json_object(model.name.as_str(), &results));
    } else {
        show(model.name.as_str(), arguments, &results);
    }
    Ok(())
}

fn measure(
    arguments: &Arguments,
    loaded_model: &LoadedModel,
    input: &Input,
) -> Result<Vec<(&'static str, SortedValues)>, Failure> {
    let all = arguments.warm_up.saturating_add(arguments.iterations.get());
    let mut progress = Progress::new(arguments.quiet, loaded_model.clock().mono());
    // The durations of each stage, and last the duration of the whole call.
    let mut durations: [Vec<f64>; 4] = Default::default();
    // Samples are used in turn; there is at least one.
    for (done, sample) in (0..all).zip(input.samples.iter().cycle()) {
        // Measured outside of the model, because the stages do not contain the time to hand over the sample.
        let started_at = loaded_model.clock().mono();
        let (answer, tree) = loaded_model.infer(sample.clone());
        let total = (loaded_model.clock().mono() - started_at).seconds();
        answer.map_err(|error| Failure::new(Exit::Unavailable, error))?;
        if done >= arguments.warm_up {
            for (values, stage) in durations.iter_mut().zip(STAGES) {
                values.extend(stage_seconds(&tree, stage));
            }
            durations[3].push(total);
        }
        let state = || (format!("{} of {all}", done + 1), (done + 1) as f64 / all as f64);
        let no_trouble = None;
        progress.show(loaded_model.clock().mono(), no_trouble, state);
    }
    progress.end();
    let names = STAGES.into_iter().chain(["all"]);
    Ok(names.zip(durations).map(|(name, values)| (name, values.into_iter().collect())).collect())
}

fn stage_seconds(tree: &Tree, stage: &str) -> Option<f64> {
    tree.find(&[stage]).and_then(|(_, node)| node.measure.value())
}

fn show(name: &str, arguments: &Arguments, results: &BenchResults) {
    let threads = arguments.options.intra_threads;
    print_to_stdout(format_args!(
        "{name} on {}, {} within an operator, one sample at a time",
        results.device,
        counted(threads.get() as u64, "thread")
    ));
    print_to_stdout(format_args!(
        "{} samples after {} of warm-up: {}",
        arguments.iterations, arguments.warm_up, results.input
    ));
    print_to_stdout("");
    let row = |(stage, values): &(&str, SortedValues)| {
        let cells =
            QUANTILES.map(|(_, quantile)| quantile(values).map_or_else(|| NONE.to_owned(), milliseconds));
        [vec![(*stage).to_owned()], cells.into()].concat()
    };
    let header = ["stage", "p50 ms", "p95 ms", "p99 ms"];
    print_to_stdout(text(&header, &results.stages.iter().map(row).collect::<Vec<_>>()));
    let size_text =
        |bytes_of: Option<u64>| bytes_of.map_or_else(|| "?".to_owned(), |count| bytes(count as f64).plain());
    print_to_stdout(format_args!("loaded in {} ms", milliseconds(results.load_s)));
    print_to_stdout(format_args!(
        "memory of this process: {} before, {} with the model, {} at most; the memory of an accelerator is not included",
        size_text(results.memory[0]),
        size_text(results.memory[1]),
        size_text(results.peak)
    ));
}

fn json_object(name: &str, results: &BenchResults) -> Value {
    let stage = |(stage, values): &(&str, SortedValues)| {
        let quantiles = QUANTILES.map(|(name, quantile)| (name.to_owned(), json!(quantile(values))));
        let mut figures = serde_json::Map::from_iter(quantiles);
        figures.insert("count".to_owned(), values.len().into());
        ((*stage).to_owned(), Value::Object(figures))
    };
    json!({
        "model": name,
        "device": results.device,
        "input": results.input,
        "loaded_in": results.load_s,
        "seconds": serde_json::Map::from_iter(results.stages.iter().map(stage)),
        "memory_bytes": {
            "before": results.memory[0], "with_model": results.memory[1], "peak": results.peak,
        },
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn p99_needs_more_than_100_samples() {
        let few: SortedValues = (0..100).map(f64::from).collect();
        assert_eq!(QUANTILES.map(|(_, quantile)| quantile(&few).is_some()), [true, true, false]);
    }
}
