//! Tests of writing a spool and reading it back.

use peernet_stream::{Chain, NewestSentBatch, StreamId, Usage};

use super::*;

#[tokio::test]
async fn new_spool_is_empty_and_keeps_its_stream() {
    let spool_folder = SpoolFolder::new();
    let (file, fresh) = spool_folder.open_undamaged().await;
    assert_eq!(
        (fresh.first, fresh.oldest, fresh.chain_before_oldest, fresh.newest),
        (1, 1, Chain::START, (0, Chain::START))
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
    let written_batches = batches(Chain::START, 1..=9, 100);
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
    let some = file.load(6, 150).await.expect("loads");
    assert_eq!(
        (some.batches.as_slice(), some.damage),
        (&written_batches[5..7], None),
        "until they exceed it"
    );
    let single = file.load(6, 0).await.expect("loads");
    assert_eq!(single.batches.as_slice(), &written_batches[5..6], "one at least");
}

#[tokio::test]
async fn emptied_spool_keeps_its_position() {
    let spool_folder = SpoolFolder::new();
    let (mut file, _) = spool_folder.open_undamaged().await;
    let written_batches = batches(Chain::START, 1..=2, 10);
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
async fn batches_stored_without_spool_leave_no_gap() {
    // While the disk failed, batches 3 to 5 were sent from memory and acknowledged.
    let spool_folder = SpoolFolder::new();
    let (mut file, _) = spool_folder.open_undamaged().await;
    let created_batches = batches(Chain::START, 1..=7, 10);
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
    let written_batches = batches(Chain::START, 1..=3, 10);
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
async fn senders_from_file_are_remembered() {
    let spool_folder = SpoolFolder::new();
    let (mut file, fresh) = spool_folder.open_undamaged().await;
    assert_eq!(fresh.newest_sent, []);
    let written_batches = batches(Chain::START, 1..=6, 10);
    let totals_of_sender = |process, number| {
        let newest_sent = NewestSentBatch { process, number };
        (newest_sent, Totals { newest_sent: Some(newest_sent), ..totals(9) })
    };
    let ((first, as_first), (second, as_second)) = (totals_of_sender(u64::MAX, 2), totals_of_sender(5, 4));
    file.append(&written_batches[..2], &as_first).await.expect("appends");
    file.append(&[], &totals_of_sender(5, 2).1).await.expect("appends");
    file.append(&written_batches[2..4], &as_second).await.expect("appends");
    file.append(&written_batches[4..], &totals(18)).await.expect("appends out of contact");
    file.close().await.expect("closes");
    let (mut file, state) = spool_folder.open_undamaged().await;
    assert_eq!(state.newest_sent, [second, first]);
    for process in 100..200 {
        file.append(&[], &totals_of_sender(process, 6).1).await.expect("appends");
    }
    file.delete_through(6, written_batches[5].chain).await.expect("deletes");
    file.close().await.expect("closes");
    let newest_sent = spool_folder.open_undamaged().await.1.newest_sent;
    assert!(
        newest_sent.len() == 64 && newest_sent.iter().all(|newest_sent| newest_sent.number == 6),
        "{newest_sent:?}"
    );
}

#[tokio::test]
async fn repeated_append_replaces_batches() {
    let spool_folder = SpoolFolder::new();
    let (mut file, _) = spool_folder.open_undamaged().await;
    let written_batches = batches(Chain::START, 1..=2, 10);
    file.append(&written_batches[..1], &totals(3)).await.expect("appends");
    file.append(&written_batches, &totals(6)).await.expect("appends what seemed to have failed");
    assert_eq!(file.load(1, usize::MAX).await.expect("loads").batches, written_batches);
}

#[tokio::test]
async fn second_agent_and_other_hosts_spool_are_refused() {
    let spool_folder = SpoolFolder::new();
    let (file, _) = spool_folder.open_undamaged().await;
    let error = spool_folder.open().await.expect_err("one has it").to_string();
    assert!(error.contains("another agent uses") && error.contains("spool.sqlite"), "{error}");
    drop(file.close().await);
    let other = HostId::from_bytes([8; 16]);
    let error = OpenSpool::open(&spool_folder.path(), other, true, &clock())
        .await
        .expect_err("another host's")
        .to_string();
    assert!(error.contains(&host().to_string()) && error.contains(&other.to_string()), "{error}");
    spool_folder.open().await.expect("nothing was changed");
}
