//! `peernet recompute`

use peernet_report::number::{milliseconds, milliseconds_with};
use peernet_report::table::text;
use peernetd::exit::Failure;
use peernetd::output::say;
use serde::Deserialize;
use serde_json::Value;

use crate::api::Api;

/// What `peernet recompute` can be told.
#[derive(Debug, clap::Args)]
pub(crate) struct Arguments {
    /// Number of the run, as on its page.
    run: i64,
    #[command(flatten)]
    api: Api,
    /// Print what the aggregator answers, as JSON in SI units.
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Deserialize)]
struct Recomputed {
    samples: u64,
    stages: Vec<Stage>,
}

#[derive(Debug, Deserialize)]
struct Stage {
    stage: String,
    before: Judgement,
    after: Judgement,
}

#[derive(Debug, Deserialize)]
struct Judgement {
    delay: Option<Figures>,
    half_width: Option<Figures>,
    verdicts: Vec<VerdictCount>,
}

#[derive(Debug, Deserialize)]
struct Figures {
    mean: f64,
    std: Option<f64>,
    p50: f64,
    p95: Option<f64>,
}

#[derive(Debug, Deserialize)]
struct VerdictCount {
    verdict: String,
    count: u64,
}

/// Prints the delays before and after, side by side.
///
/// # Errors
/// When the aggregator does not answer, or has no such run.
pub(crate) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let path = format!("/api/v1/runs/{}/recomputed", arguments.run);
    if arguments.json {
        let answer: Value = arguments.api.get(&path)?;
        say(format_args!("{answer:#}"));
        return Ok(());
    }
    let recomputed: Recomputed = arguments.api.get(&path)?;
    say(describe(arguments.run, &recomputed));
    Ok(())
}

fn describe(run: i64, recomputed: &Recomputed) -> String {
    let Recomputed { samples, stages } = recomputed;
    if stages.is_empty() {
        return format!("run {run} has no one-way delays: nothing of it travelled between two hosts");
    }
    let header = ["delay", "", "mean ± std ms", "median ms", "p95 ms", "bound ms", "verdicts"];
    let rows: Vec<Vec<String>> = stages
        .iter()
        .flat_map(|Stage { stage, before, after }| [row(stage, "before", before), row("", "after", after)])
        .collect();
    let table = text(&header, &rows);
    format!(
        "{table}\n\nrun {run}, computed again with {samples} seconds of what was learnt of the two clocks, during the run and after it; nothing stored was changed"
    )
}

fn row(stage: &str, when: &str, judgement: &Judgement) -> Vec<String> {
    let delay = judgement.delay.as_ref();
    let verdicts: Vec<String> = judgement
        .verdicts
        .iter()
        .map(|VerdictCount { verdict, count }| format!("{count} {verdict}"))
        .collect();
    let spread = |figures: &Figures| milliseconds_with(figures.mean, figures.std);
    vec![
        stage.to_owned(),
        when.to_owned(),
        known(delay.map(spread)),
        known(delay.map(|figures| milliseconds(figures.p50))),
        known(delay.and_then(|figures| figures.p95).map(milliseconds)),
        known(judgement.half_width.as_ref().map(|figures| format!("±{}", milliseconds(figures.p50)))),
        known(Some(verdicts.join(", ")).filter(|verdicts| !verdicts.is_empty())),
    ]
}

fn known(figure: Option<String>) -> String {
    figure.unwrap_or_else(|| "—".to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn before_and_after_stand_side_by_side() {
        let recomputed: Recomputed = serde_json::from_value(serde_json::json!({
            "run": 7, "samples": 60,
            "stages": [{
                "stage": "upload",
                "before": { "delay": null, "half_width": null, "verdicts": [{ "verdict": "unsynchronised", "count": 40 }] },
                "after": {
                    "delay": { "count": 40, "mean": 0.00631, "std": 0.0004, "min": 0.006, "p50": 0.0062, "p95": null, "p99": null, "max": 0.009 },
                    "half_width": { "count": 40, "mean": 6e-5, "std": null, "min": 6e-5, "p50": 6e-5, "p95": null, "p99": null, "max": 6e-5 },
                    "verdicts": [{ "verdict": "ok", "count": 39 }, { "verdict": "limited", "count": 1 }],
                },
            }],
        }))
        .expect("as the API answers");
        let expected = "\
delay           mean ± std ms  median ms  p95 ms  bound ms          verdicts
upload  before              —          —       —         —  40 unsynchronised
         after   6.31 ± 0.40       6.20       —   ±0.0600   39 ok, 1 limited

run 7, computed again with 60 seconds of what was learnt of the two clocks, during the run and after it; nothing stored was changed";
        let squeeze = |text: &str| text.split_whitespace().collect::<Vec<_>>().join(" ");
        assert_eq!(squeeze(&describe(7, &recomputed)), squeeze(expected));
        let empty = Recomputed { samples: 0, stages: Vec::new() };
        assert!(describe(7, &empty).contains("no one-way delays"));
    }
}
