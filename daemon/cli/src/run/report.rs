//! Reports about the runs: tables of the comparison, tables of concurrent users and of sensors, figures, and whether
//! the runs can be published.

use std::path::Path;

use crate::exit::{Exit, Failure};
use anyhow::anyhow;
use peernet_analysis::WriteError;
use peernet_analysis::compare::{Comparison, SEED, compare_positions};
use peernet_analysis::loaded::Loaded;
use peernet_analysis::table::CaptionedTable;
use peernet_analysis::trust::publication_summary;
use peernet_analysis::users::Users;
use peernet_results::ResultFolder;

use super::folder::Folder;
use super::plan::Run;
use super::sensors_table::SensorsTable;
use super::state::Record;
use crate::compare::{default_baseline, difference_tables, differences, join_texts};
use crate::experiment::unfinished_runs_note;

/// Text about the runs, and the failure of drawing their figures.
pub(super) struct Report {
    /// Text to be printed.
    pub(super) text: String,
    /// Reason why not all figures are drawn; `None` if all are drawn or none is wanted.
    pub(super) figure_error: Option<WriteError>,
}

/// Writes everything that compares finished runs: tables, and with `plots` also figures.
///
/// # Errors
/// When results cannot be read (exit code 65), or tables cannot be written (exit code 73).
pub(super) fn write(folder: &Folder, record: &Record, plots: bool) -> Result<Report, Failure> {
    let mut runs: Vec<&Run> =
        record.runs().filter(|(_, state)| state.status.is_done()).map(|(run, _)| run).collect();
    if runs.is_empty() {
        return Ok(Report { text: String::new(), figure_error: None });
    }
    // The runs are in the order of the file, not in the order in which they were measured.
    let position = |run: &Run| record.plan.experiment_position(run, &record.id);
    runs.sort_by(|a, b| compare_positions(&position(a), &position(b)));
    let loaded = runs.iter().map(|run| load(folder, record, run)).collect::<Result<Vec<_>, _>>()?;
    let sensors = SensorsTable::from_runs(&record.plan, &runs, &loaded);
    let reports = runs.iter().zip(&loaded).flat_map(|(run, edges)| {
        edges.iter().map(move |edge| (run.folder.clone(), edge.record.trust.as_ref()))
    });
    let publication = publication_summary(reports);
    let all: Vec<Loaded> = loaded.into_iter().flatten().collect();
    let users = Users::from_runs(&all);
    let mut comparison = Comparison::new(&all);
    let statuses = record.runs().map(|(run, state)| (&*run.folder, state.status));
    // The caveat is "Shown without the runs of experiment … that are not done: …".
    comparison
        .caveats
        .extend(unfinished_runs_note(record.name.as_str(), statuses).map(|note| format!("Shown {note}.")));
    // These are the differences that `peernet compare` prints.
    let differences = differences(&comparison, &all, default_baseline(&comparison), SEED);
    let tables = difference_tables(&comparison, &differences);
    let files = [
        ("txt", join_texts(comparison.text(), tables.iter().map(CaptionedTable::text))),
        ("md", join_texts(comparison.markdown(), tables.iter().map(CaptionedTable::markdown))),
        ("csv", comparison.csv()),
        ("tex", join_texts(comparison.latex(), tables.iter().map(CaptionedTable::latex))),
    ];
    save(folder.path(), "compare", &files)?;
    // If figures cannot be drawn, the tables are printed nevertheless.
    let figure_error = plots.then(|| peernet_figures::of_experiment(&all, folder.path()).err()).flatten();
    let mut parts = vec![comparison.text()];
    if let Some(users) = users {
        let files =
            [("txt", users.text()), ("md", users.markdown()), ("csv", users.csv()), ("tex", users.latex())];
        save(folder.path(), "users", &files)?;
        parts.push(users.text());
    }
    if let Some(sensors) = sensors {
        let files = [("txt", sensors.text()), ("md", sensors.markdown()), ("tex", sensors.latex())];
        save(folder.path(), "sensors", &files)?;
        if sensors.covers_all_runs {
            // The comparison and the table of users are omitted, because the stages after the
            // sensor are empty. The comparison would rank the sensors by the shortest sensing,
            // which does not make a sensor the best one.
            parts.clear();
        }
        parts.push(sensors.text());
    }
    parts.push(publication);
    let text = parts.iter().map(|part| part.trim_end()).collect::<Vec<_>>().join("\n\n");
    Ok(Report { text, figure_error })
}

fn load(folder: &Folder, record: &Record, run: &Run) -> Result<Vec<Loaded>, Failure> {
    let open = |path| ResultFolder::open(path).map_err(|error| Failure::new(Exit::Data, error));
    folder.results(&record.plan, run).iter().map(|path| open(path)).collect()
}

fn save(folder: &Path, name: &str, files: &[(&str, String)]) -> Result<(), Failure> {
    for (extension, text) in files {
        let path = folder.join(format!("{name}.{extension}"));
        std::fs::write(&path, format!("{}\n", text.trim_end())).map_err(|error| {
            Failure::new(Exit::Unwritten, anyhow!("cannot write {}: {error}", path.display()))
        })?;
    }
    Ok(())
}
