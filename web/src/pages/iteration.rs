//! Page of one iteration: the time that each stage took, and the reasons if the iteration was slow.

use askama::Template;
use axum::Router;
use axum::extract::rejection::PathRejection;
use axum::extract::{Path, State};
use axum::routing::get;
use peernet_analysis::rows::Outcome;
use peernet_analysis::slowness::USUAL_RATIOS;
use peernet_figures::scale::Scale;
use peernet_statistics::number::{NONE, count, duration, times};
use peernet_store::{IterationDetail, IterationRow, RunDetail, RunSummary};

use super::registration::PageRegistration;
use super::shell::Shell;
use super::{Page, page, path};
use crate::error::WebError;
use crate::look;
use crate::picture::Picture;
use crate::state::{App, AppState};
use crate::timeline::Timeline;
use crate::view::bytes::{ByteRow, OtherMeasurement};
use crate::view::chip::Chip;
use crate::view::runs::reject_deleted;
use crate::view::waterfall::{DelayRow, Row, delays, footnote, journey, rails, rows};
use crate::view::{clock_fault, link, place};

/// Registration of this page.
pub(super) const PAGE: PageRegistration = PageRegistration {
    routes: || Router::new().route("/runs/{run}/iterations/{iteration}", get(show)),
    entry: None,
    topic: None,
};

#[derive(Template)]
#[template(path = "pages/iteration.html")]
struct Iteration {
    shell: Shell,
    run: i64,
    run_name: String,
    /// Number of the iteration, formatted.
    label: String,
    title: String,
    facts: Vec<String>,
    warm_up: bool,
    clock_fault: Option<Chip>,
    /// Address of the page of the link that the iteration used.
    link: Option<String>,
    /// Number of the previous iteration, plain and formatted.
    previous: Option<(u64, String)>,
    /// Number of the next iteration, plain and formatted.
    next: Option<(u64, String)>,
    /// Number of the next slower iteration of the run.
    slower: Option<u64>,
    /// Number of the next faster iteration of the run.
    faster: Option<u64>,
    edge: String,
    cloud: Option<String>,
    axis: Picture,
    /// Time lines of both hosts, with the messages between the hosts; `None` without another host.
    rails: Option<Picture>,
    rows: Vec<Row>,
    note: Option<String>,
    delays: Vec<DelayRow>,
    bytes: Vec<ByteRow>,
    other_measurements: Vec<OtherMeasurement>,
}

/// `GET /runs/{run}/iterations/{iteration}`.
async fn show(State(app): State<App>, numbers: Result<Path<(i64, u64)>, PathRejection>) -> Page {
    let (run_number, number) = path(numbers)?;
    let store = app.store();
    let detail = store.iteration(run_number, number).await?;
    let run = store.run(run_number).await?;
    let run = run.ok_or_else(|| WebError::NotFound(format!("no run #{run_number} is stored")))?;
    let Some(detail) = detail else {
        reject_deleted(&run.summary, number, app.aggregator.retention())?;
        return Err(WebError::NotFound(format!("run #{run_number} has no stored iteration {number}")));
    };
    page(&assemble(&app, &run, &detail))
}

/// Returns the title of the page. For a successful iteration: the duration, its ratio to the run's
/// median, and the causes if the iteration was slow. Otherwise: the outcome, and the duration and
/// the reason if they are known.
fn title(row: &IterationRow) -> String {
    let Some(total) = row.total.filter(|_| row.outcome == Outcome::Ok) else {
        let reason = row.reason.as_ref().map_or_else(String::new, |reason| format!(": {reason}"));
        let outcome = row.outcome.display_name();
        let duration_text = row.total.map_or_else(String::new, |total| format!(" after {}", duration(total)));
        return format!("Iteration {outcome}{duration_text}{reason}");
    };
    let total_text = duration(total);
    let Some(factor) = row.factor else { return format!("{total_text}") };
    if USUAL_RATIOS.contains(&factor) {
        return format!("{total_text}, close to the run's median");
    }
    let causes = row
        .causes
        .iter()
        .map(|cause| format!("{} +{}", look::label(cause.name.as_str()), duration(cause.excess())));
    let causes = causes.collect::<Vec<_>>().join(", ");
    let because = if causes.is_empty() { String::new() } else { format!(": {causes}") };
    format!("{total_text}, {} the run's median{because}", times(factor))
}

fn ordinal(number: u64) -> String {
    let suffix = match (number % 10, number % 100) {
        (_, 11..=13) => "th",
        (1, _) => "st",
        (2, _) => "nd",
        (3, _) => "rd",
        _ => "th",
    };
    format!("{}{suffix}", count(number))
}

fn facts(app: &AppState, run: &RunSummary, detail: &IterationDetail) -> Vec<String> {
    let row = &detail.row;
    let at = app.zone.moment(row.started);
    let mut facts = vec![
        format!("Iteration {}", count(row.number)),
        format!("{}, {}", at.date(), at.time_with_milliseconds()),
        format!("episode {}, step {}", count(row.episode.into()), count(row.step.into())),
    ];
    // The rank is among the stored iterations that succeeded and are not warm-up. If none of them was deleted, their
    // number is `counts.ok`.
    let base = if run.last_deleted_iteration > 0 {
        "the iterations that are still stored".to_owned()
    } else {
        count(run.counts.ok)
    };
    facts.extend(detail.rank.map(|rank| match rank {
        1 => format!("slowest of {base}"),
        rank => format!("{} slowest of {base}", ordinal(rank)),
    }));
    facts
}

fn assemble(app: &AppState, stored: &RunDetail, detail: &IterationDetail) -> Iteration {
    let (run, row) = (&stored.summary, &detail.row);
    let snapshot = app.live_state();
    let timeline = Timeline::of(detail);
    let ticks = 6;
    let scale = Scale::up_to(timeline.end * 1e3, ticks);
    let host = |index: usize| {
        let name = detail.hosts.get(index).and_then(Option::as_ref).map(ToString::to_string);
        name.unwrap_or_else(|| if index == 0 { run.host_name.to_string() } else { NONE.to_owned() })
    };
    let hosts: Vec<String> = (0..detail.tree.anchors().len()).map(host).collect();
    let edge = hosts.first().cloned().unwrap_or_default();
    let cloud = timeline.visit().and_then(|_| hosts.get(1).cloned());
    let neighbour = |number: Option<u64>| number.map(|number| (number, count(number)));
    Iteration {
        shell: Shell::new(
            app,
            &snapshot,
            "/runs",
            format!("Iteration {} of {}", count(row.number), place::run_name(run)),
        ),
        run: run.number,
        run_name: place::run_name(run),
        label: count(row.number),
        title: title(row),
        facts: facts(app, run, detail),
        warm_up: row.warm_up,
        clock_fault: run.has_clock_fault.then_some(clock_fault::CHIP),
        link: link::href_of_placement(&snapshot, run.host_name.as_str(), &run.placement),
        previous: neighbour(detail.previous),
        next: neighbour(detail.next),
        slower: detail.slower,
        faster: detail.faster,
        axis: Picture::milliseconds_axis(&scale, ""),
        rails: cloud.as_ref().and_then(|cloud| rails(&timeline, &journey(&timeline, &edge, cloud), &scale)),
        rows: rows(detail, &timeline, &hosts, &scale),
        note: cloud.as_ref().and_then(|cloud| footnote(&timeline, cloud)),
        delays: delays(&timeline, &detail.row.delays),
        bytes: ByteRow::of_directions(detail),
        other_measurements: OtherMeasurement::all(detail),
        edge,
        cloud,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tests::samples;
    use peernet_analysis::slowness::Cause;
    use peernet_statistics::number::SPACE;

    #[test]
    fn title_names_duration_factor_and_causes() {
        let mut row = samples::iteration().row;
        row.total = Some(0.030_21);
        row.factor = Some(1.873);
        row.causes = vec![
            Cause { name: "upload".into(), value: 0.015_91, median: 0.006_28 },
            Cause { name: "lateness".into(), value: 0.004_53, median: 0.000_08 },
        ];
        assert_eq!(
            title(&row),
            "30.2\u{202f}ms, 1.9\u{202f}× the run's median: upload +9.63\u{202f}ms, late start +4.45\u{202f}ms"
        );
        row.factor = Some(1.01);
        assert_eq!(title(&row), "30.2\u{202f}ms, close to the run's median");
        (row.factor, row.causes) = (Some(0.8), Vec::new());
        assert_eq!(title(&row), "30.2\u{202f}ms, 0.80\u{202f}× the run's median");
        row.outcome = Outcome::Lost;
        row.reason = Some("connection to rack-a closed".into());
        assert_eq!(title(&row), format!("Iteration lost after 30.2{SPACE}ms: connection to rack-a closed"));
    }

    #[test]
    fn ranks_are_english_ordinals() {
        let words: Vec<String> = [2, 3, 11, 19, 21, 112, 1_003].map(ordinal).to_vec();
        assert_eq!(words, ["2nd", "3rd", "11th", "19th", "21st", "112th", "1,003rd"]);
    }
}
