//! The task of a link. It sends probes, passes on the announcements of both hosts' clocks, runs the proof that both
//! hosts read one clock, and closes each second.

use std::convert::Infallible;
use std::pin::pin;
use std::sync::Arc;
use std::time::Duration;

use peernet_networks::PeerClock;
use peernet_probes::ProbeResult;
use peernet_stream::Probing;
use tokio::sync::{mpsc, watch};

use super::answer_monitor::AnswerMonitor;
use super::cloud_link::CloudLink;
use super::probe_target::{ProbeTarget, RESULT_CAPACITY};
use super::shared::{Session, lock};
use crate::same_clock::prove;

/// Runs the task of a link until its last session has ended.
pub(super) async fn run_link_task(link: Arc<CloudLink>) {
    let mut reflector_probing = pin!(link.probe_named_reflector());
    let mut sessions = link.sessions.subscribe();
    loop {
        // One session is enough: each session has the cloud's address and receives the announcements of the cloud's
        // clocks. The oldest session is used, so that the task changes to another session only when a session ends.
        let Some(session) = sessions.borrow_and_update().first().cloned() else { break };
        tokio::select! {
            () = run_over_session(&link, session, &mut sessions) => {}
            never = &mut reflector_probing => match never {},
        }
    }
    link.finish();
}

/// Runs the task over one session, until that session has ended.
async fn run_over_session(
    link: &Arc<CloudLink>,
    session: Session,
    sessions: &mut watch::Receiver<Vec<Session>>,
) {
    let id = session.id;
    let authenticated = link.shared.probes.key_for(&session).is_some();
    let (mut peer_clock, mut own_clock) = (session.clock.clone(), link.shared.host.host_clock.clone());
    // The newest announcements may have arrived before this call. After this mark the loop below handles them.
    peer_clock.mark_changed();
    own_clock.mark_changed();
    let (results, mut received_results) = mpsc::channel(RESULT_CAPACITY);
    let mut probing = pin!(probe(link, &session, results));
    let clock = &link.shared.host.clock;
    let mut proving = pin!(prove(&session.clock_peers, clock, |proof| link.set_same_clock(proof)));
    // Only a configured key can differ between both ends: the session's key comes from the cloud.
    let mut monitor = AnswerMonitor::new(link.cloud.name.clone(), link.shared.probes.key.is_some());
    loop {
        let end_of_second = pin!(tokio::time::sleep(time_to_next_second(clock.wall().unix_nanos())));
        tokio::select! {
            biased;
            change = sessions.changed() => {
                let is_oldest = sessions.borrow_and_update().first().is_some_and(|first| first.id == id);
                if change.is_err() || !is_oldest {
                    break;
                }
            }
            Ok(()) = own_clock.changed() => {
                let clock = own_clock.borrow_and_update().clone();
                link.handle_edge_announcement(clock);
            }
            clock = next_announcement(&mut peer_clock) => link.handle_cloud_announcement(clock),
            Some(result) = received_results.recv() => {
                link.handle_probe_result(&result, authenticated);
                monitor.record(&result, link.shared.host.clock.mono(), &mut lock(&link.probing));
            }
            () = end_of_second => link.advance_second(),
            never = &mut proving => match never {},
            never = &mut probing => match never {},
        }
    }
    // The session has ended. Probes without an answer count as lost, so that each sent probe is either answered or
    // lost.
    while let Ok(result) = received_results.try_recv() {
        link.handle_probe_result(&result, authenticated);
        monitor.record(&result, link.shared.host.clock.mono(), &mut lock(&link.probing));
    }
    for _ in 0..monitor.in_flight() {
        link.handle_probe_result(&ProbeResult::Lost, authenticated);
    }
    link.settle_sessions();
}

/// Waits for the cloud's next announcement of its clocks. After the end of the session this function waits for ever.
async fn next_announcement(clock: &mut watch::Receiver<PeerClock>) -> PeerClock {
    match clock.changed().await {
        Ok(()) => clock.borrow_and_update().clone(),
        Err(_) => std::future::pending().await,
    }
}

/// Probes the cloud of a session as long as the future is polled. Sets the link's `probing` state.
async fn probe(link: &CloudLink, session: &Session, results: mpsc::Sender<ProbeResult>) -> Infallible {
    let Some(port) = session.probe_port else {
        *lock(&link.probing) = Probing::Off(format!("{} answers no probes", link.cloud.name));
        return std::future::pending().await;
    };
    let target = ProbeTarget {
        peer: link.cloud.name.clone(),
        host: session.host.clone(),
        port,
        key: link.shared.probes.key_for(session),
        instance: Some(session.instance),
        clocks: link.cloud.clocks,
    };
    target.probe(&link.shared, &link.pace, &link.probing, results).await
}

/// Returns the time from a reading of a clock to the next full second of that clock.
fn time_to_next_second(unix_nanos: i64) -> Duration {
    const SECOND: i64 = 1_000_000_000;
    Duration::from_nanos((SECOND - unix_nanos.rem_euclid(SECOND)).unsigned_abs())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn next_second_begins_within_one_second() {
        assert_eq!(time_to_next_second(0), Duration::from_secs(1));
        assert_eq!(time_to_next_second(1_999_999_999), Duration::from_nanos(1));
        assert_eq!(time_to_next_second(-1), Duration::from_nanos(1));
    }
}
