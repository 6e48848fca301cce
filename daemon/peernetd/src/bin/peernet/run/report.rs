//! What is made of the runs: the tables of the comparison, those of many users, and the figures.

use std::path::Path;

use anyhow::anyhow;
use peernet_report::WriteError;
use peernet_report::compare::Comparison;
use peernet_report::figures::{self, Columns, Kind, PlotError};
use peernet_report::results::{Loaded, ResultFolder};
use peernet_report::sensor_study::SensorStudy;
use peernet_report::trust::Publish;
use peernet_report::users::Users;
use peernetd::exit::{Exit, Failure};

use super::folder::Folder;
use super::plan::Run;
use super::state::{Record, Stage};

/// Writes everything that compares finished runs, with `plots` also as figures; returns what is to be printed.
///
/// # Errors
/// When results cannot be read (65), or tables or figures cannot be written (73).
pub(super) fn write(folder: &Folder, record: &Record, plots: bool) -> Result<String, Failure> {
    let mut runs: Vec<&Run> =
        record.runs().filter(|(_, state)| state.stage == Stage::Finished).map(|(run, _)| run).collect();
    if runs.is_empty() {
        return Ok(String::new());
    }
    // As the file has them, whatever the order in which they came.
    runs.sort_by_key(|run| (run.configuration, run.repeat));
    let loaded = runs.iter().map(|run| load(folder, record, run)).collect::<Result<Vec<_>, _>>()?;
    let users = Users::of(&loaded);
    let (studies, trust) = (studies(record, &runs, &loaded), trust(&loaded));
    let all: Vec<Loaded> = loaded.into_iter().flatten().collect();
    let comparison = Comparison::of(&all);
    let forms = [
        ("txt", comparison.text()),
        ("md", comparison.markdown()),
        ("csv", comparison.csv()),
        ("tex", comparison.latex()),
    ];
    save(folder.path(), "compare", &forms)?;
    if plots {
        figures(&all, comparison.lines.len(), folder.path())
            .map_err(|error| Failure::new(Exit::Unwritten, error))?;
    }
    let mut told = comparison.text();
    if let Some(users) = users {
        let forms =
            [("txt", users.text()), ("md", users.markdown()), ("csv", users.csv()), ("tex", users.latex())];
        save(folder.path(), "users", &forms)?;
        told = format!("{}\n\n{}", told.trim_end(), users.text());
    }
    for study in studies {
        told = format!("{}\n\n{study}", told.trim_end());
    }
    Ok(format!("{}\n\n{trust}", told.trim_end()))
}

/// Draws what the configurations have together. Bars side by side need more than one.
fn figures(all: &[Loaded], lines: usize, folder: &Path) -> Result<(), WriteError> {
    if lines > 1 {
        return figures::of_experiment(all, folder).map(drop);
    }
    match figures::draw(Kind::Payload, all, &Columns::default(), folder) {
        Err(PlotError::Write(error)) => Err(error),
        Ok(_) | Err(PlotError::Lacking(..)) => Ok(()),
    }
}

/// What sensors alone showed of themselves, each below the name of its run.
fn studies(record: &Record, runs: &[&Run], loaded: &[Vec<Loaded>]) -> Vec<String> {
    let edges =
        runs.iter().zip(loaded).flat_map(|(run, users)| users.iter().map(move |edge| (run, users, edge)));
    let alone = edges.filter(|(_, _, edge)| edge.record.is_sensor_alone());
    let study = alone.filter_map(|(run, users, edge)| {
        let user = if users.len() > 1 { format!(", {}", edge.record.edge.name) } else { String::new() };
        let study = SensorStudy::of(&edge.rows)?;
        Some(format!("{}{user}\n{}", record.plan.words(run), study.text().trim_end()))
    });
    study.collect()
}

/// Whether the runs can be published, in a sentence. A run is as good as the worst of its edges.
fn trust(runs: &[Vec<Loaded>]) -> String {
    let worst = |edges: &Vec<Loaded>| {
        let verdicts = edges.iter().map(|edge| edge.record.trust.as_ref().map(|trust| trust.verdict));
        let known: Option<Vec<Publish>> = verdicts.collect();
        [Publish::No, Publish::WithRemarks, Publish::Yes]
            .into_iter()
            .find(|verdict| known.as_ref().is_some_and(|known| known.contains(verdict)))
    };
    let count = |verdict| runs.iter().filter(|edges| worst(edges) == Some(verdict)).count();
    let [yes, remarks, no] = [Publish::Yes, Publish::WithRemarks, Publish::No].map(count);
    format!(
        "Can they be published? {yes} yes, {remarks} with remarks, {no} no: trust in each run.json says why."
    )
}

fn load(folder: &Folder, record: &Record, run: &Run) -> Result<Vec<Loaded>, Failure> {
    let open = |path| ResultFolder::open(path).map_err(|error| Failure::new(Exit::Data, error));
    folder.results(&record.plan, run).iter().map(|path| open(path)).collect()
}

fn save(folder: &Path, name: &str, forms: &[(&str, String)]) -> Result<(), Failure> {
    for (kind, text) in forms {
        let path = folder.join(format!("{name}.{kind}"));
        std::fs::write(&path, format!("{}\n", text.trim_end())).map_err(|error| {
            Failure::new(Exit::Unwritten, anyhow!("cannot write {}: {error}", path.display()))
        })?;
    }
    Ok(())
}
