//! Note on runs of an experiment that its tables and figures exclude because they are not finished.

use peernet_statistics::number::list_first;

use super::RunStatus;

/// Returns the note on the runs that tables and figures of an experiment lack: their folders and states. `None` if
/// all are done. The note completes a sentence: `Shown without the runs of experiment e that are not done: 002
/// (failed).`
pub(crate) fn unfinished_runs_note<'a>(
    experiment: &str,
    runs: impl IntoIterator<Item = (&'a str, RunStatus)>,
) -> Option<String> {
    let unfinished: Vec<String> = runs
        .into_iter()
        .filter(|(_, status)| !status.is_done())
        .map(|(folder, status)| format!("{folder} ({})", status.name()))
        .collect();
    (!unfinished.is_empty()).then(|| {
        format!("without the runs of experiment {experiment} that are not done: {}", list_first(&unfinished))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unfinished_runs_are_named_up_to_limit() {
        let note = |runs: &[(&str, RunStatus)]| unfinished_runs_note("e", runs.iter().copied());
        assert_eq!(note(&[("001", RunStatus::Finished)]), None);
        let two = [("001", RunStatus::Finished), ("002", RunStatus::Running), ("003", RunStatus::Pending)];
        let text =
            "without the runs of experiment e that are not done: 002 (in progress or killed), 003 (to do)";
        assert_eq!(note(&two).as_deref(), Some(text));
        let many = note(&[("0", RunStatus::Failed); 20]).expect("none is done");
        assert!(many.ends_with("0 (failed), 0 (failed) and 12 more"), "{many}");
    }
}
