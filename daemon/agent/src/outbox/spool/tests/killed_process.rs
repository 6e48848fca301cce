//! Tests of the losses of a killed process. A test drops the file and the counter in place of the kill.

use peernet_logger::{RunId, Slug};
use peernet_stream::{KILLED_REASON, SentUnspooled, SubmittedEvents};

use super::*;
use crate::event_queue::EventCounter;
use crate::outbox::spool::quarantine::flag_as_damaged;

fn at(nanos: i64) -> WallTime {
    WallTime::from_unix_nanos(nanos)
}

/// Counts `events` events of a run.
fn count_events(counter: &EventCounter, run: RunId, events: u64) {
    let pipeline: Slug = "line".parse().expect("a name");
    (0..events).for_each(|nanos| counter.count(Some(&pipeline), Some(run), at(nanos.cast_signed())));
}

/// Returns the totals `before` with `events` further batched events of a run; gaps report `reported` lost events.
fn totals_after(run: RunId, events: u64, reported: u64, before: &Totals) -> Totals {
    let mut submitted = SubmittedEvents { last: Some(at(1)), ..SubmittedEvents::default() };
    submitted.batched.add(Some(run), events);
    Totals { produced: before.produced + events, reported_drops: reported, submitted, ..before.clone() }
}

#[tokio::test]
async fn losses_of_killed_process_stay_until_reported() {
    let (spool_folder, run) = (SpoolFolder::new(), RunId::random());
    let OpenSpool { mut file, state, counter, .. } = spool_folder.open().await.expect("opens");
    count_events(&counter, run, 10);
    file.append(&batches(ChainHash::START, 1..=2, 10), &totals_after(run, 6, 0, &state.totals))
        .await
        .expect("appends");
    drop((file, counter));

    let second_run = RunId::random();
    let OpenSpool { file, state, counter, .. } = spool_folder.open().await.expect("opens");
    let losses_of = |state: &SpoolState| -> Vec<_> {
        state.unreported.iter().map(|gap| (gap.run, gap.count, gap.reason.clone())).collect()
    };
    assert_eq!((state.totals.produced, state.totals.dropped, state.totals.reported_drops), (10, 4, 0));
    assert_eq!(losses_of(&state), [(Some(run), 4, KILLED_REASON.to_owned())]);
    assert_eq!((state.unreported[0].from, state.unreported[0].to), (at(1), at(9)));
    // The second process is also killed before it reports the loss. The second process loses one event.
    count_events(&counter, second_run, 1);
    drop((file, counter));

    let OpenSpool { mut file, state, counter, .. } = spool_folder.open().await.expect("opens");
    let losses = [(Some(run), 4, KILLED_REASON.to_owned()), (Some(second_run), 1, KILLED_REASON.to_owned())];
    assert_eq!((losses_of(&state), state.totals.dropped), (losses.to_vec(), 5));
    assert_eq!(spool_folder.lost_when_killed().await, Some(5));
    let third_run = RunId::random();
    count_events(&counter, third_run, 3);
    file.append(&batches(state.newest.1, 3..=3, 10), &totals_after(third_run, 3, 4, &state.totals))
        .await
        .expect("appends");
    drop((file, counter));

    let (_, state) = spool_folder.open_undamaged().await;
    assert_eq!(losses_of(&state), losses[1..], "a reported loss is not reported again");
    assert_eq!(spool_folder.lost_when_killed().await, Some(5), "reported losses stay counted");
}

#[tokio::test]
async fn unspooled_batches_stay_unresolved_until_aggregator_answers() {
    let (spool_folder, run) = (SpoolFolder::new(), RunId::random());
    let OpenSpool { mut file, state, counter, .. } = spool_folder.open().await.expect("opens");
    count_events(&counter, run, 10);
    file.append(&batches(ChainHash::START, 1..=2, 10), &totals_after(run, 6, 0, &state.totals))
        .await
        .expect("appends");
    counter.record_sent_unspooled(SentUnspooled {
        process: 7,
        number: 3,
        batched: 8,
        reported_drops: 0,
        events: 8,
    });
    drop((file, counter));

    let OpenSpool { file, state, counter, .. } = spool_folder.open().await.expect("opens");
    let unresolved = state.unresolved.expect("batch 3 may be stored");
    assert_eq!((unresolved.counted.total, unresolved.settled.events.events_of(run)), (10, 6));
    assert_eq!((unresolved.settled.batched, unresolved.spooled_events), (6, 6));
    assert_eq!((state.totals.dropped, state.unreported.len()), (0, 0));
    // This process is killed before the aggregator has answered. It loses one event.
    count_events(&counter, run, 1);
    drop((file, counter));

    let OpenSpool { mut file, state, counter, .. } = spool_folder.open().await.expect("opens");
    assert_eq!(state.unresolved.as_ref(), Some(&unresolved));
    assert_eq!((state.totals.dropped, state.unreported.len()), (1, 1));
    // The aggregator answers that it has stored batch 3, and with it 8 of the first 10 events. Two of these events and
    // the event of the second process are lost.
    let mut lost = state.unreported[0].clone();
    lost.count = 3;
    let resolved = Totals { dropped: 3, unreported: Some(vec![lost.clone()]), ..state.totals };
    file.append(&[], &resolved).await.expect("appends");
    drop((file, counter));

    let (_, state) = spool_folder.open_undamaged().await;
    assert_eq!((state.unresolved, state.unreported, state.totals.dropped), (None, vec![lost], 3));
    assert_eq!(spool_folder.lost_when_killed().await, Some(3));
}

#[tokio::test]
async fn missing_counter_file_reports_no_loss() {
    let (spool_folder, run) = (SpoolFolder::new(), RunId::random());
    let OpenSpool { file, counter, .. } = spool_folder.open().await.expect("opens");
    count_events(&counter, run, 10);
    counter.remove();
    drop((file, counter));
    let (_, state) = spool_folder.open_undamaged().await;
    assert_eq!((state.totals, state.unreported), (Totals::default(), Vec::new()));
}

#[tokio::test]
async fn only_original_spool_reports_loss_and_not_its_copy() {
    let (spool_folder, copy, run) = (SpoolFolder::new(), SpoolFolder::new(), RunId::random());
    let OpenSpool { mut file, state, counter, .. } = spool_folder.open().await.expect("opens");
    file.append(&batches(ChainHash::START, 1..=2, 10), &totals_after(run, 6, 0, &state.totals))
        .await
        .expect("appends");
    for name in ["spool.sqlite", "spool.sqlite-wal"] {
        std::fs::copy(spool_folder.folder.path().join(name), copy.folder.path().join(name)).expect("copied");
    }
    count_events(&counter, run, 10);

    let (_, copy_state) = copy.open_undamaged().await;
    assert_eq!((copy_state.unreported, copy_state.totals.dropped), (Vec::new(), 0));
    drop((file, counter));

    let (_, state) = spool_folder.open_undamaged().await;
    assert_eq!((state.unreported.len(), state.totals.dropped), (1, 4), "the original spool has the loss");
}

#[tokio::test]
async fn losses_are_reported_after_recovery_of_damaged_spool() {
    let (spool_folder, run) = (SpoolFolder::new(), RunId::random());
    let OpenSpool { mut file, state, counter, .. } = spool_folder.open().await.expect("opens");
    count_events(&counter, run, 10);
    file.append(&batches(ChainHash::START, 1..=2, 10), &totals_after(run, 6, 0, &state.totals))
        .await
        .expect("appends");
    flag_as_damaged(&spool_folder.path(), "a page was broken");
    file.close().await.expect("closes");
    drop(counter);

    let OpenSpool { state, quarantined, counter, .. } = spool_folder.open().await.expect("opens");
    counter.remove();
    let recovered = quarantined.expect("is quarantined").recovered.expect("the batches are intact");
    assert_eq!((recovered.batches, recovered.lost_batches), (2, Some(0)));
    let losses: Vec<_> = state.unreported.iter().map(|gap| (gap.run, gap.count)).collect();
    assert_eq!((losses, state.totals.produced, state.totals.dropped), (vec![(Some(run), 4)], 10, 4));
}

#[tokio::test]
async fn counts_of_deleted_spools_are_removed_at_start() {
    let (deleted, spool_folder) = (SpoolFolder::new(), SpoolFolder::new());
    let OpenSpool { file, counter, .. } = deleted.open().await.expect("opens");
    let counter_file = Path::new("/dev/shm").join(counter.name().expect("the counter has a file"));
    drop((file, counter, deleted));
    spool_folder.open_undamaged().await;
    assert!(!counter_file.exists());
}
