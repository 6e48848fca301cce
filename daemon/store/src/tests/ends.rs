//! Runs whose agent was killed, runs known by their iterations only, and gaps left by quarantined batches.

use peernet_logger::RunId;
use peernet_stream::{BatchHead, EndReason, Event, RunEnded, codec};

use super::{Bed, NOW, STAMP, Work, generate, open};
use crate::stored::Stored;
use crate::write::{Aside, RunName, stored_hosts, unknown_runs};

const LEFT: &str = "the agent ended without saying so";

fn iterations(bed: &Bed, run: RunId, numbers: std::ops::RangeInclusive<u64>) -> Vec<Event> {
    let mut random = generate::Numbers::new(*numbers.start());
    numbers.map(|n| Event::Iteration(generate::iteration(run, n, bed.hosts(), &mut random))).collect()
}

fn hello(bed: &Bed, process: u64) -> Work {
    super::hello(generate::host(bed.edge, "edge"), process)
}

async fn ends(bed: &Bed) -> Vec<Option<(f64, String)>> {
    let mut runs = bed.store.runs(&crate::RunFilter::default()).await.expect("answers");
    runs.reverse();
    let end = |ended: peernet_clock::WallTime| (ended - generate::at(0.0)).seconds();
    runs.into_iter().map(|run| Some((end(run.ended?), run.reason?.to_string()))).collect()
}

#[tokio::test]
async fn new_process_ends_runs_of_previous_one_only() {
    let mut bed = Bed::new().await;
    bed.run_of(10).await;
    let (same, after_restart) = (hello(&bed, 1), hello(&bed, 1));
    bed.commit(&[same]).await;
    bed.writer = open(&bed.path).await;
    bed.commit(&[after_restart]).await;
    assert_eq!(ends(&bed).await, [None]);

    // The hello of the next process and its first run are in one transaction.
    let (greeting, run) = (hello(&bed, u64::MAX), RunId::random());
    let begun = bed.batch(vec![generate::run_started(run, "other", NOW)]);
    bed.commit(&[greeting, begun]).await;
    assert_eq!(ends(&bed).await, [Some((2.0, LEFT.to_owned())), None]);
}

#[tokio::test]
async fn goodbye_ends_open_runs() {
    let mut bed = Bed::new().await;
    let first = bed.run_of(10).await;
    bed.commit(&[Work::Goodbye(bed.cloud)]).await;
    assert_eq!(ends(&bed).await, [None]);
    let end = RunEnded { run: first, ended: generate::at(9.0), reason: EndReason::Stopped };
    let ended = bed.batch(vec![Event::RunEnded(end)]);
    let begun = bed.batch(vec![generate::run_started(RunId::random(), "line", generate::at(10.0))]);
    bed.commit(&[ended, begun, Work::Goodbye(bed.edge)]).await;
    assert_eq!(ends(&bed).await, [Some((9.0, "stopped".to_owned())), Some((10.0, LEFT.to_owned()))]);
}

#[tokio::test]
async fn new_run_of_pipeline_ends_previous_one() {
    let mut bed = Bed::new().await;
    let first = bed.run_of(10).await;
    let (second, other) = (RunId::random(), RunId::random());
    let begun = bed.batch(vec![
        generate::run_started(other, "other", NOW),
        generate::run_started(second, "line", NOW),
        generate::run_started(second, "line", NOW),
    ]);
    bed.commit(&[begun]).await;
    assert_eq!(ends(&bed).await, [Some((2.0, LEFT.to_owned())), None, None]);

    // Late iterations are stored and move the end; the reported end replaces it.
    let late = iterations(&bed, first, 11..=15);
    let late = bed.batch(late);
    bed.commit(&[late]).await;
    assert_eq!(ends(&bed).await[0], Some((3.0, LEFT.to_owned())));
    assert_eq!(bed.count("SELECT ok FROM run WHERE number = 1").await, 15);
    let end = RunEnded { run: first, ended: generate::at(2.5), reason: EndReason::Stopped };
    let later = iterations(&bed, first, 16..=16);
    let real = bed.batch(vec![Event::RunEnded(end)]);
    let later = bed.batch(later);
    bed.commit(&[real, later]).await;
    assert_eq!(ends(&bed).await[0], Some((2.5, "stopped".to_owned())));
}

#[tokio::test]
async fn live_event_names_run_known_by_iterations_once() {
    let mut bed = Bed::new().await;
    let run = RunId::random();
    let events = iterations(&bed, run, 4..=6);
    let work = bed.batch(events);
    assert_eq!(bed.commit(&[work]).await.unknown, [(bed.edge, run)]);
    let mut connection = crate::database::open(&bed.path).await.expect("opens");
    assert_eq!(unknown_runs(&mut connection, 10).await.expect("reads"), [(bed.edge, run)]);

    let name = |host, pipeline: &str| {
        let pipeline = pipeline.parse().expect("a name");
        Work::Name(Box::new(RunName { host, run, pipeline, placement: generate::remote() }))
    };
    let (foreign, first) = (name(bed.cloud, "stolen"), name(bed.edge, "line"));
    let (second, unheard) = (name(bed.edge, "later"), RunId::random());
    let nobody = Work::Name(Box::new(RunName {
        host: bed.edge,
        run: unheard,
        pipeline: "line".parse().expect("a name"),
        placement: generate::remote(),
    }));
    bed.commit(&[foreign, first]).await;
    bed.commit(&[second, nobody]).await;
    let detail = bed.store.run(1).await.expect("answers").expect("exists");
    assert_eq!((detail.summary.pipeline.as_str(), &detail.summary.placement), ("line", &generate::remote()));
    assert_eq!(bed.count("SELECT count(*) FROM run").await, 1);
    assert!(unknown_runs(&mut connection, 10).await.expect("reads").is_empty());
}

#[tokio::test]
async fn events_of_quarantined_batches_count_as_missing() {
    let mut bed = Bed::new().await;
    let run = bed.run_of(5).await;
    // A batch with an iteration three times, a truncated batch, and one whose head claims more events than it has bytes.
    let twice = [6, 6, 6].map(|n| iterations(&bed, run, n..=n)).concat();
    let twice = bed.batch(twice);
    let mut unreadable = |events: u32| {
        let body = generate::body(&vec![generate::run_started(run, "line", NOW); 2]);
        let number = bed.next;
        bed.next += 1;
        let head = BatchHead { events, ..bed.head(number, &body, 2) };
        let mut frame = codec::batch_frame(&head, &body, false);
        frame.truncate(frame.len() / 2);
        let reason = "cut off".into();
        Work::Aside(Box::new(Aside { head, frame: frame.into(), body: None, reason }))
    };
    let (short, impossible) = (unreadable(2), unreadable(u32::MAX));
    let committed = bed.commit(&[twice, short, impossible]).await;
    assert_eq!(committed.quarantined.len(), 3);
    let (stored, _) = committed.hosts[&bed.edge];
    assert_eq!((stored.quarantined, stored.gaps, stored.missing), (3, 3, 5));
    let detail = bed.store.run(1).await.expect("answers").expect("exists");
    assert_eq!((detail.gaps.len(), detail.gaps[0].count), (1, 3));
    assert!(detail.gaps[0].reason.starts_with("a batch was put aside: "), "{}", detail.gaps[0].reason);
    assert_eq!(bed.count("SELECT count(*) FROM gap WHERE run IS NULL AND count = 0").await, 1);

    let mut connection = crate::database::open(&bed.path).await.expect("opens");
    let hosts = stored_hosts(&mut connection, 10).await.expect("reads");
    let known = hosts.iter().find(|(host, _)| *host == bed.edge).map(|(_, stored)| *stored);
    assert_eq!(known, Some(Stored { duplicates: 0, ..stored }));
}

#[tokio::test]
async fn commit_to_moved_file_is_refused() {
    let mut bed = Bed::new().await;
    let run = RunId::random();
    let work = [bed.batch(vec![generate::run_started(run, "line", NOW)])];
    let elsewhere = bed.path.with_extension("away");
    std::fs::rename(&bed.path, &elsewhere).expect("moves");
    let refused = bed.writer.commit(&work, STAMP).await.expect_err("moved").to_string();
    assert!(
        refused.contains("was deleted, moved or replaced") && refused.contains("put it back"),
        "{refused}"
    );
    std::fs::write(&bed.path, "another file").expect("writes");
    assert!(bed.writer.check_file().is_err());
    std::fs::rename(&elsewhere, &bed.path).expect("moves back");
    assert_eq!(bed.commit(&work).await.marks[&bed.stream].stored, 1);
    assert_eq!(bed.count("SELECT count(*) FROM run").await, 1);
}
