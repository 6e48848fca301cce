//! `peernet recompute`: shows the one-way delays of a stored run, as stored and as computed again
//! from the exchanges during the run and after it.

use crate::exit::Failure;
use crate::output::print_to_stdout;
use peernet_analysis::table::text;
use peernet_clock::RelatedClocks;
use peernet_statistics::number::{
    self, NONE, bound_ms, column_decimals, fixed_mean_std_ms, fixed_ms, is_exact, join_mean_std,
};
use peernet_stream::FaultyHost;
use serde::Deserialize;
use serde_json::Value;

use crate::api::Api;

/// Arguments of `peernet recompute`.
#[derive(Debug, clap::Args)]
pub(crate) struct Arguments {
    /// Number of the run, as the dashboard shows it.
    run: i64,
    #[command(flatten)]
    api: Api,
    /// Print the answer of the aggregator: JSON in SI units.
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Deserialize)]
struct Recomputed {
    /// Number of clock samples that were used. A clock sample covers one second of exchanges.
    samples: u64,
    /// Clocks by which delays were judged. Aggregators of releases before 0.3.0 do not report them and use wall clocks.
    #[serde(default = "wall_clocks")]
    clocks: Vec<String>,
    stages: Vec<Stage>,
}

/// Facts of the run, as its start reported them.
#[derive(Debug, Deserialize)]
struct Run {
    facts: Vec<Fact>,
}

#[derive(Debug, Deserialize)]
struct Fact {
    name: String,
    value: String,
}

#[derive(Debug, Deserialize)]
struct Stage {
    stage: String,
    before: Judgement,
    after: Judgement,
}

#[derive(Debug, Deserialize)]
struct Judgement {
    delay: Option<Statistics>,
    half_width: Option<Statistics>,
    verdicts: Vec<VerdictCount>,
}

#[derive(Debug, Deserialize)]
struct Statistics {
    mean: f64,
    std: Option<f64>,
    p50: f64,
    p95: Option<f64>,
    max: f64,
}

#[derive(Debug, Deserialize)]
struct VerdictCount {
    verdict: String,
    count: u64,
}

/// Prints the delays as stored (`before`) and as computed again (`after`), in adjacent rows.
///
/// # Errors
/// When the aggregator does not answer, or has no such run (exit code 69).
pub(crate) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let path = format!("/api/v1/runs/{}/recomputed", arguments.run);
    if arguments.json {
        let answer: Value = arguments.api.get_computed(&path)?;
        print_to_stdout(format_args!("{answer:#}"));
        return Ok(());
    }
    let recomputed: Recomputed = arguments.api.get_computed(&path)?;
    let run: Run = arguments.api.get(&format!("/api/v1/runs/{}", arguments.run))?;
    print_to_stdout(describe(arguments.run, &recomputed));
    if let Some(clock_fault) = clock_fault(&run.facts) {
        print_to_stdout(format_args!(
            "\nCLOCK FAULT INJECTION: run {} was made with a clock that was wrong on purpose: {clock_fault}",
            arguments.run
        ));
    }
    Ok(())
}

/// Returns the hosts with clock faults, and the faults, from the facts of a run; `None` for an ordinary run.
fn clock_fault(facts: &[Fact]) -> Option<String> {
    let owner = |name: &str| match FaultyHost::from_fact_name(name)? {
        FaultyHost::Edge => Some("the edge's".to_owned()),
        FaultyHost::Cloud(cloud) => Some(format!("{cloud}'s")),
    };
    let parts: Vec<String> =
        facts.iter().filter_map(|fact| Some(format!("{} ({})", owner(&fact.name)?, fact.value))).collect();
    (!parts.is_empty()).then(|| parts.join(", "))
}

fn describe(run: i64, recomputed: &Recomputed) -> String {
    let Recomputed { samples, clocks, stages } = recomputed;
    if stages.is_empty() {
        return format!("run {run} has no one-way delays: it sent no message between two hosts");
    }
    let header = ["delay", "", "mean ± std ms", "median ms", "p95 ms", "bound ms", "verdicts"];
    let rows: Vec<Vec<String>> = stages
        .iter()
        .flat_map(|Stage { stage, before, after }| {
            let bounds =
                [before, after].map(|judgement| judgement.half_width.as_ref().map(|width| width.p50));
            // Both rows of a delay get the same number of decimals, so that they can be compared digit by digit.
            let decimals = column_decimals(bounds);
            [row(stage, "before", before, decimals), row("", "after", after, decimals)]
        })
        .collect();
    let table = text(&header, &rows);
    let basis = match samples {
        // Checked first: delays by one clock need no exchanges, so the number of exchanges does not matter.
        _ if are_exact(stages) => "both hosts use one clock, so the delays are exact".to_owned(),
        0 => "no usable exchanges between the two hosts are stored".to_owned(),
        samples => format!(
            "computed again {} from {} of exchanges between the two hosts, during the run and after it",
            describe_clocks(clocks),
            number::counted(*samples, "second")
        ),
    };
    format!("{table}\n\nrun {run}: {basis}; nothing stored was changed")
}

fn wall_clocks() -> Vec<String> {
    vec!["wall".to_owned()]
}

/// Describes the clocks by which delays were judged again.
fn describe_clocks(clocks: &[String]) -> String {
    let phrases = clocks.iter().map(|name| match RelatedClocks::from_name(name) {
        Some(related @ (RelatedClocks::Raw | RelatedClocks::RawToWall)) => format!("by {}", related.words()),
        _ => format!("by {}, whose steps and slews change these delays,", RelatedClocks::Wall.words()),
    });
    phrases.collect::<Vec<_>>().join(" and ")
}

/// Returns whether all delays are exact.
fn are_exact(stages: &[Stage]) -> bool {
    let has_exact_delays =
        |stage: &Stage| stage.after.half_width.as_ref().is_some_and(|width| is_exact(width.max));
    stages.iter().all(has_exact_delays)
}

fn row(stage: &str, when: &str, judgement: &Judgement, decimals: usize) -> Vec<String> {
    let delay = judgement.delay.as_ref();
    let milliseconds = |seconds: f64| fixed_ms(seconds, decimals);
    let verdicts: Vec<String> = judgement
        .verdicts
        .iter()
        .map(|VerdictCount { verdict, count }| format!("{} {verdict}", number::count(*count)))
        .collect();
    let spread =
        |statistics: &Statistics| join_mean_std(fixed_mean_std_ms(statistics.mean, statistics.std, decimals));
    vec![
        stage.to_owned(),
        when.to_owned(),
        or_dash(delay.map(spread)),
        or_dash(delay.map(|statistics| milliseconds(statistics.p50))),
        or_dash(delay.and_then(|statistics| statistics.p95).map(milliseconds)),
        or_dash(judgement.half_width.as_ref().map(|statistics| bound_ms(statistics.p50))),
        or_dash(Some(verdicts.join(", ")).filter(|verdicts| !verdicts.is_empty())),
    ]
}

fn or_dash(figure: Option<String>) -> String {
    figure.unwrap_or_else(|| NONE.to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn before_and_after_are_shown_together() {
        let recomputed: Recomputed = serde_json::from_value(serde_json::json!({
            "run": 7, "samples": 60, "clocks": ["raw"],
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
        .expect("the form of the API's answer");
        let expected = "\
delay           mean ± std ms  median ms  p95 ms  bound ms          verdicts
upload  before              —          —       —         —  40 unsynchronised
         after   6.310 ± 0.400    6.200       —    ±0.060   39 ok, 1 limited

run 7: computed again by free-running clocks from 60 seconds of exchanges between the two hosts, during the run and after it; nothing stored was changed";
        let squeeze = |text: &str| text.split_whitespace().collect::<Vec<_>>().join(" ");
        assert_eq!(squeeze(&describe(7, &recomputed)), squeeze(expected));

        let earlier = Recomputed { clocks: wall_clocks(), ..recomputed };
        let text = describe(7, &earlier);
        assert!(
            text.contains("again by wall clocks, whose steps and slews change these delays, from 60 seconds"),
            "{text}"
        );

        let mut stages = earlier.stages;
        let after = &mut stages[0].after;
        for statistics in [&mut after.delay, &mut after.half_width].into_iter().flatten() {
            *statistics = Statistics { std: statistics.std, mean: 0.0, p50: 0.0, p95: None, max: 0.0 };
        }
        if let Some(delay) = &mut stages[0].after.delay {
            (delay.mean, delay.std, delay.p50) = (1.2e-3, Some(15.02e-3), 59.5e-6);
        }
        let one_clock = describe(7, &Recomputed { samples: 0, clocks: Vec::new(), stages });
        assert!(one_clock.contains("1.200 ± 15.020") && one_clock.contains(" 0.060 "), "{one_clock}");
        assert!(
            one_clock.contains(" exact ") && one_clock.contains("both hosts use one clock"),
            "{one_clock}"
        );
        assert!(!one_clock.contains("0 seconds"), "{one_clock}");
        let empty = Recomputed { samples: 0, clocks: Vec::new(), stages: Vec::new() };
        assert!(describe(7, &empty).contains("no one-way delays"));
    }

    #[test]
    fn clock_fault_is_recognised_from_facts() {
        let fact = |(name, value): (&str, &str)| Fact { name: name.to_owned(), value: value.to_owned() };
        let facts =
            |facts: &[(&str, &str)]| clock_fault(&facts.iter().copied().map(fact).collect::<Vec<_>>());
        // Earlier releases called a clock fault a rehearsal.
        assert_eq!(facts(&[("Sensor", "synthetic"), ("Rehearsals", "3")]), None);
        assert_eq!(
            facts(&[("Rehearsal of cloud", "offset +1000 ms"), ("Clock fault", "offset -5 ms")]).as_deref(),
            Some("cloud's (offset +1000 ms), the edge's (offset -5 ms)")
        );
    }
}
