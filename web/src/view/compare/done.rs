//! Which runs of an experiment count: those that `peernet run` takes as done. One that was interrupted is done again in
//! the same experiment, and so is one that was finished and lost its results, or one of several users.

use peernet_store::RunSummary;
use peernet_stream::EndReason;

use super::LeftOut;

/// The runs that count, in their order, and those that do not. A run that goes on counts.
pub(super) fn parted(runs: Vec<RunSummary>) -> (Vec<RunSummary>, Vec<LeftOut>) {
    let (mut counted, mut left_out) = (Vec::<RunSummary>::with_capacity(runs.len()), Vec::new());
    for run in runs {
        if let Some(reason) = run.reason.as_ref().filter(|reason| **reason != EndReason::Finished) {
            left_out.push(LeftOut { run: run.number, why: reason.to_string() });
            continue;
        }
        if let Some(before) = counted.iter().position(|known| is_again(known, &run)) {
            let before = counted.remove(before);
            left_out.push(LeftOut { run: before.number, why: format!("done again as #{}", run.number) });
        }
        counted.push(run);
    }
    left_out.sort_by_key(|one| one.run);
    (counted, left_out)
}

/// Whether both are the same repeat of the same configuration on the same host.
fn is_again(before: &RunSummary, run: &RunSummary) -> bool {
    let place =
        |run: &RunSummary| run.experiment.as_ref().map(|place| (place.configuration.clone(), place.repeat));
    (before.host, &before.pipeline) == (run.host, &run.pipeline) && place(before) == place(run)
}

#[cfg(test)]
mod tests {
    use peernet_logger::HostId;
    use peernet_stream::{ExperimentPlace, PlacementKind};

    use super::*;
    use crate::view::compare::tests::run;

    #[test]
    fn each_repeat_of_a_configuration_counts_once_and_only_if_it_was_finished() {
        let host = HostId::random();
        let of = |number, rate: &str, repeat, reason| RunSummary {
            host,
            reason,
            experiment: Some(ExperimentPlace {
                name: "rates".to_owned(),
                id: "x".to_owned(),
                configuration: vec![("rate".to_owned(), rate.to_owned())],
                repeat,
            }),
            ..run(number, PlacementKind::Local)
        };
        let other_user = RunSummary { host: HostId::random(), ..of(5, "10", 0, Some(EndReason::Finished)) };
        let runs = vec![
            of(1, "10", 0, Some(EndReason::Finished)),
            of(2, "20", 0, Some(EndReason::Stopped)),
            of(3, "20", 0, Some(EndReason::Finished)),
            of(4, "10", 1, Some(EndReason::Finished)),
            other_user,
            of(6, "10", 0, Some(EndReason::Finished)),
            of(7, "20", 1, None),
        ];
        let (counted, left_out) = parted(runs);
        assert_eq!(counted.iter().map(|run| run.number).collect::<Vec<_>>(), [3, 4, 5, 6, 7]);
        let left_out: Vec<(i64, &str)> = left_out.iter().map(|one| (one.run, one.why.as_str())).collect();
        assert_eq!(left_out, [(1, "done again as #6"), (2, "stopped")]);
    }
}
