//! What is made of the runs: the tables of the comparison, those of many users, and the figures.

use std::path::Path;

use anyhow::anyhow;
use peernet_report::compare::Comparison;
use peernet_report::figures;
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
    let loaded = runs.into_iter().map(|run| load(folder, record, run)).collect::<Result<Vec<_>, _>>()?;
    let users = Users::of(&loaded);
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
        figures::of_experiment(&all, folder.path()).map_err(|error| Failure::new(Exit::Unwritten, error))?;
    }
    let mut told = comparison.text();
    if let Some(users) = users {
        let forms =
            [("txt", users.text()), ("md", users.markdown()), ("csv", users.csv()), ("tex", users.latex())];
        save(folder.path(), "users", &forms)?;
        told = format!("{}\n\n{}", told.trim_end(), users.text());
    }
    for run in all.iter().filter(|run| run.record.is_sensor_alone()) {
        if let Some(study) = SensorStudy::of(&run.rows) {
            told = format!("{}\n\n{}: {}", told.trim_end(), labels(run), study.text());
        }
    }
    Ok(format!("{}\n\n{}", told.trim_end(), trust(&all)))
}

/// What distinguishes a run, for a heading.
fn labels(run: &Loaded) -> String {
    let place = run.record.experiment.as_ref();
    let labels = place.into_iter().flat_map(|place| &place.configuration);
    let labels: Vec<_> = labels.map(|(axis, label)| format!("{axis} = {label}")).collect();
    if labels.is_empty() { run.record.title.clone() } else { labels.join(", ") }
}

/// Whether the runs can be published, in a sentence.
fn trust(runs: &[Loaded]) -> String {
    let count = |verdict| {
        runs.iter()
            .filter(|run| run.record.trust.as_ref().is_some_and(|trust| trust.verdict == verdict))
            .count()
    };
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
