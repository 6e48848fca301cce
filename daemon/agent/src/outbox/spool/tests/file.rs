//! Tests of writing a spool and reading it back.

use peernet_stream::{ChainHash, NewestSendableBatch, StreamId, Usage};

use super::*;

#[tokio::test]
async fn new_spool_is_empty_and_keeps_its_stream() {
    let spool_folder = SpoolFolder::new();
    let (file, fresh) = spool_folder.open_undamaged().await;
    assert_eq!(
        (fresh.first, fresh.oldest, fresh.chain_before_oldest, fresh.newest),
        (1, 1, ChainHash::START, (0, ChainHash::START))
    );
    assert_eq!(
        (fresh.previous_stream, fresh.since, fresh.waiting_usage, fresh.totals.clone()),
        (None, None, Usage::default(), Totals::default())
    );
    file.close().await.expect("closes");
    let (_, reopened) = spool_folder.open_undamaged().await;
    assert_eq!(reopened, fresh);
    let (_, other) = SpoolFolder::new().open_undamaged().await;
    assert_ne!(other.stream, fresh.stream);
}

#[tokio::test]
async fn batches_totals_and_deletions_survive_reopening() {
    let spool_folder = SpoolFolder::new();
    let (mut file, fresh) = spool_folder.open_undamaged().await;
    let written_batches = batches(ChainHash::START, 1..=9, 100);
    file.append(&written_batches[..4], &totals(12)).await.expect("appends");
    file.append(&written_batches[4..], &totals(29)).await.expect("appends");
    file.delete_through(3, written_batches[2].chain).await.expect("deletes");
    file.close().await.expect("closes");

    let (mut file, state) = spool_folder.open_undamaged().await;
    assert_eq!(
        (state.stream, state.first, state.oldest, state.chain_before_oldest),
        (fresh.stream, 1, 4, written_batches[2].chain)
    );
    assert_eq!((state.newest, state.since), ((9, written_batches[8].chain), Some(written_batches[3].since)));
    assert_eq!((state.waiting_usage, state.totals), (Usage { events: 18, bytes: 600 }, totals(29)));

    let all = file.load(4, usize::MAX).await.expect("loads");
    assert_eq!((all.batches.as_slice(), all.damage), (&written_batches[3..], None));
    let limited = file.load(6, 150).await.expect("loads");
    assert_eq!(
        (limited.batches.as_slice(), limited.damage),
        (&written_batches[5..7], None),
        "batches are read until their length reaches 150 bytes"
    );
    let single = file.load(6, 0).await.expect("loads");
    assert_eq!(single.batches.as_slice(), &written_batches[5..6], "at least one batch is read");
}

#[tokio::test]
async fn emptied_spool_keeps_batch_number_and_chain() {
    let spool_folder = SpoolFolder::new();
    let (mut file, _) = spool_folder.open_undamaged().await;
    let written_batches = batches(ChainHash::START, 1..=2, 10);
    file.append(&written_batches, &totals(6)).await.expect("appends");
    file.delete_through(2, written_batches[1].chain).await.expect("deletes");
    drop(file.close().await);
    let (_, state) = spool_folder.open_undamaged().await;
    assert_eq!((state.oldest, state.chain_before_oldest), (3, written_batches[1].chain));
    assert_eq!(
        (state.newest, state.since, state.waiting_usage),
        ((2, written_batches[1].chain), None, Usage::default())
    );
    assert_eq!(state.totals, totals(6));
}

#[tokio::test]
async fn batches_that_were_never_spooled_are_not_missing() {
    // While the disk failed, batches 3 to 5 were sent from memory and acknowledged.
    let spool_folder = SpoolFolder::new();
    let (mut file, _) = spool_folder.open_undamaged().await;
    let created_batches = batches(ChainHash::START, 1..=7, 10);
    file.append(&created_batches[..2], &totals(6)).await.expect("appends");
    file.delete_through(5, created_batches[4].chain).await.expect("deletes");
    file.append(&created_batches[5..], &totals(21)).await.expect("appends");
    assert_eq!(file.load(6, usize::MAX).await.expect("loads").batches, created_batches[5..]);
    drop(file.close().await);
    let (_, state) = spool_folder.open_undamaged().await;
    assert_eq!(
        (state.oldest, state.chain_before_oldest, state.newest),
        (6, created_batches[4].chain, (7, created_batches[6].chain))
    );
}

#[tokio::test]
async fn renewed_spool_keeps_batches_under_new_stream_id() {
    let spool_folder = SpoolFolder::new();
    let (mut file, fresh) = spool_folder.open_undamaged().await;
    let written_batches = batches(ChainHash::START, 1..=3, 10);
    file.append(&written_batches, &totals(9)).await.expect("appends");
    file.delete_through(1, written_batches[0].chain).await.expect("deletes");
    let renewed = StreamId::random();
    file.renew(renewed, fresh.stream, (2, 3)).await.expect("renews");
    drop(file.close().await);
    let (mut file, state) = spool_folder.open_undamaged().await;
    assert_eq!((state.stream, state.previous_stream, state.first), (renewed, Some(fresh.stream), 2));
    assert_eq!(file.load(2, usize::MAX).await.expect("loads").batches, written_batches[1..]);
}

#[tokio::test]
async fn newest_sendable_batch_of_each_process_survives_reopening() {
    let spool_folder = SpoolFolder::new();
    let (mut file, fresh) = spool_folder.open_undamaged().await;
    assert_eq!(fresh.newest_sendable, []);
    let written_batches = batches(ChainHash::START, 1..=6, 10);
    let totals_of_process = |process, number| {
        let newest_sendable = NewestSendableBatch { process, number };
        (newest_sendable, Totals { newest_sendable: Some(newest_sendable), ..totals(9) })
    };
    let ((first, totals_of_first), (second, totals_of_second)) =
        (totals_of_process(u64::MAX, 2), totals_of_process(5, 4));
    file.append(&written_batches[..2], &totals_of_first).await.expect("appends");
    file.append(&[], &totals_of_process(5, 2).1).await.expect("appends");
    file.append(&written_batches[2..4], &totals_of_second).await.expect("appends");
    // Without a connection the totals have no `newest_sendable`. The file keeps the earlier records.
    file.append(&written_batches[4..], &totals(18)).await.expect("appends");
    file.close().await.expect("closes");
    let (mut file, state) = spool_folder.open_undamaged().await;
    assert_eq!(state.newest_sendable, [second, first]);
    for process in 100..200 {
        file.append(&[], &totals_of_process(process, 6).1).await.expect("appends");
    }
    file.delete_through(6, written_batches[5].chain).await.expect("deletes");
    file.close().await.expect("closes");
    // The deletion keeps the records of 64 processes, those with the largest batch numbers.
    let newest_sendable = spool_folder.open_undamaged().await.1.newest_sendable;
    assert!(
        newest_sendable.len() == 64 && newest_sendable.iter().all(|newest| newest.number == 6),
        "{newest_sendable:?}"
    );
}

#[tokio::test]
async fn repeated_append_replaces_batches() {
    let spool_folder = SpoolFolder::new();
    let (mut file, _) = spool_folder.open_undamaged().await;
    let written_batches = batches(ChainHash::START, 1..=2, 10);
    file.append(&written_batches[..1], &totals(3)).await.expect("appends");
    file.append(&written_batches, &totals(6)).await.expect("appends the first batch again");
    assert_eq!(file.load(1, usize::MAX).await.expect("loads").batches, written_batches);
}

#[tokio::test]
async fn spool_in_use_and_spool_of_other_host_are_refused() {
    let spool_folder = SpoolFolder::new();
    let (file, _) = spool_folder.open_undamaged().await;
    let error = spool_folder.open().await.expect_err("the spool is in use").to_string();
    assert!(error.contains("another agent uses") && error.contains("spool.sqlite"), "{error}");
    drop(file.close().await);
    let other_host = HostId::from_bytes([8; 16]);
    let is_default_path = true;
    let error = OpenSpool::open(&spool_folder.path(), other_host, is_default_path, &clock())
        .await
        .expect_err("the spool of another host")
        .to_string();
    assert!(error.contains(&host().to_string()) && error.contains(&other_host.to_string()), "{error}");
    spool_folder.open().await.expect("the refused attempts changed nothing");
}
