//! Tests of the groups of batches that are committed together.

use peernet_clock::MonoTime;
use tokio::sync::Semaphore;

use super::*;

const LONG: Duration = Duration::from_secs(3600);

/// Returns work that weighs one node.
fn work_of_one_node() -> PreparedWork {
    let capacity = Arc::new(Semaphore::new(2));
    let permit = || Arc::clone(&capacity).try_acquire_owned().expect("a permit");
    PreparedWork {
        work: Work::Goodbye(HostId::random()),
        generation: 0,
        admitted_at: MonoTime::from_nanos(0),
        capacity: [permit(), permit()],
    }
}

/// Returns a queue in which `count` items of one node wait.
async fn queue_with(count: usize) -> (mpsc::Sender<PreparedWork>, mpsc::Receiver<PreparedWork>) {
    let (sender, receiver) = mpsc::channel(16);
    for _ in 0..count {
        sender.send(work_of_one_node()).await.expect("there is room");
    }
    (sender, receiver)
}

#[tokio::test]
async fn large_group_takes_ready_work_without_waiting() {
    let (_open_sender, mut queue) = queue_with(4).await;
    let grouping = Grouping { interval: LONG, min_nodes: 2, max_nodes: 100 };
    let waited = Duration::ZERO;
    assert_eq!(collect_group(work_of_one_node(), &mut queue, waited, grouping).await.len(), 5);
}

#[tokio::test]
async fn small_group_waits_until_large_enough() {
    let (sender, mut queue) = queue_with(1).await;
    let grouping = Grouping { interval: LONG, min_nodes: 4, max_nodes: 100 };
    let waited = Duration::ZERO;
    let group =
        tokio::spawn(async move { collect_group(work_of_one_node(), &mut queue, waited, grouping).await });
    tokio::task::yield_now().await;
    assert!(!group.is_finished());
    for _ in 0..2 {
        sender.send(work_of_one_node()).await.expect("there is room");
    }
    assert_eq!(group.await.expect("the group is collected").len(), 4);
}

#[tokio::test]
async fn group_is_committed_after_interval_however_small() {
    let (_open_sender, mut queue) = queue_with(1).await;
    let grouping = Grouping { interval: LONG, min_nodes: 100, max_nodes: 100 };
    let waited = LONG;
    assert_eq!(collect_group(work_of_one_node(), &mut queue, waited, grouping).await.len(), 2);
}

#[tokio::test]
async fn group_is_limited_to_max_nodes() {
    let (_open_sender, mut queue) = queue_with(10).await;
    let grouping = Grouping { interval: LONG, min_nodes: 2, max_nodes: 6 };
    let waited = Duration::ZERO;
    assert_eq!(collect_group(work_of_one_node(), &mut queue, waited, grouping).await.len(), 6);
}
