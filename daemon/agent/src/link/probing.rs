//! The task of a link: probes, what both hosts tell of their clocks, the end of each second.

use std::convert::Infallible;
use std::io;
use std::net::SocketAddr;
use std::pin::pin;
use std::sync::Arc;
use std::time::Duration;

use peernet_logger::Slug;
use peernet_networks::PeerClock;
use peernet_probes::{OpenError, ProbeResult, Prober, ProberConfig};
use peernet_stream::Probing;
use tokio::sync::{mpsc, watch};
use tokio_util::sync::CancellationToken;

use super::answers::Answers;
use super::pair::Link;
use super::shared::Session;

/// A probe without an answer for so long is lost.
const TIMEOUT: Duration = Duration::from_secs(2);
/// Pause before the prober is opened again.
const RETRY: Duration = Duration::from_secs(10);
/// Results that may wait; they are taken at once.
const RESULTS: usize = 64;

/// The reason why a link is not probed.
#[derive(Debug, thiserror::Error)]
enum ProbingError {
    #[error("this host sends no probes: [probes] send = false")]
    NotSent,
    #[error("{0} answers no probes")]
    NotAnswered(Slug),
    #[error("cannot find {host}: {source}")]
    Lookup { host: String, source: io::Error },
    #[error("cannot find {host}: the name has no address")]
    NoAddress { host: String },
    #[error(transparent)]
    Open(#[from] OpenError),
    #[error("the prober ended by itself")]
    Ended,
}

/// Looks after a link until its last session is over.
pub(super) async fn tend(link: Arc<Link>) {
    let mut sessions = link.sessions.subscribe();
    loop {
        // One session at a time tells where the cloud is and what it says of its clock: the oldest.
        let Some(session) = sessions.borrow_and_update().first().cloned() else { break };
        tend_by(&link, session, &mut sessions).await;
    }
    link.finish();
}

/// Looks after a link by means of one of its sessions, until that one is over.
async fn tend_by(link: &Arc<Link>, session: Session, sessions: &mut watch::Receiver<Vec<Session>>) {
    let id = session.id;
    let authenticated = link.shared.probes.key_for(&session).is_some();
    let (mut peer, mut own) = (session.clock.clone(), link.shared.host.own.clone());
    peer.mark_changed();
    own.mark_changed();
    let (results, mut arriving) = mpsc::channel(RESULTS);
    let mut probing = pin!(probe(link, &session, results));
    let mut answers = Answers::default();
    loop {
        let clock = &link.shared.host.clock;
        let second = pin!(tokio::time::sleep(until_next_second(clock.wall().unix_nanos())));
        tokio::select! {
            biased;
            changed = sessions.changed() => {
                let still = sessions.borrow_and_update().first().is_some_and(|first| first.id == id);
                if changed.is_err() || !still {
                    break;
                }
            }
            Ok(()) = own.changed() => {
                let clock = own.borrow_and_update().clone();
                link.edge_says(clock);
            }
            clock = next(&mut peer) => link.cloud_says(clock),
            Some(result) = arriving.recv() => {
                link.probed(&result, authenticated);
                answers.note(&result, link);
            }
            () = second => link.turn(),
            never = &mut probing => match never {},
        }
    }
    // The session is over: probes that are not answered count as lost: each that was sent is answered or lost.
    while let Ok(result) = arriving.try_recv() {
        link.probed(&result, authenticated);
        answers.note(&result, link);
    }
    for _ in 0..answers.under_way {
        link.probed(&ProbeResult::Lost, authenticated);
    }
}

/// What the cloud tells next; nothing any more when the session is over.
async fn next(clock: &mut watch::Receiver<PeerClock>) -> PeerClock {
    match clock.changed().await {
        Ok(()) => clock.borrow_and_update().clone(),
        Err(_) => std::future::pending().await,
    }
}

/// Probes the cloud of a session as long as it is polled; says at the link why it does not.
async fn probe(link: &Link, session: &Session, results: mpsc::Sender<ProbeResult>) -> Infallible {
    let port = match (link.shared.probes.send, session.probes) {
        (true, Some(port)) => port,
        (sends, _) => {
            let reason =
                if sends { ProbingError::NotAnswered(link.name.clone()) } else { ProbingError::NotSent };
            link.set_probing(Probing::Off(reason.to_string()));
            return std::future::pending().await;
        }
    };
    loop {
        match open(link, session, port).await {
            Ok((prober, target)) => {
                let stamps = prober.stamps_in_words().to_owned();
                let rate_hz = *link.rate_hz.borrow();
                link.set_probing(Probing::On { address: format!("udp://{target}"), rate_hz, stamps });
                prober.run(link.rate_hz.subscribe(), results.clone(), CancellationToken::new()).await;
                link.set_probing(Probing::Off(ProbingError::Ended.to_string()));
            }
            Err(error) => {
                tracing::warn!(peer = %link.name, "no probes: {error}");
                link.set_probing(Probing::Off(error.to_string()));
            }
        }
        tokio::time::sleep(RETRY).await;
    }
}

async fn open(link: &Link, session: &Session, port: u16) -> Result<(Prober, SocketAddr), ProbingError> {
    let host = session.host.as_str();
    let found = tokio::net::lookup_host((host, port)).await;
    let mut found = found.map_err(|source| ProbingError::Lookup { host: host.to_owned(), source })?;
    let target = found.next().ok_or_else(|| ProbingError::NoAddress { host: host.to_owned() })?;
    let probes = &link.shared.probes;
    let config = ProberConfig {
        target,
        key: probes.key_for(session),
        instance: Some(session.instance),
        clocks: link.clocks,
        padding_bytes: probes.padding_bytes,
        stamps: probes.stamps,
        timeout: TIMEOUT,
    };
    let mut prober = Prober::open(config, Arc::clone(&link.shared.host.clock))?;
    prober.check_stamps().await;
    Ok((prober, target))
}

/// From a moment to the next second of the same clock.
fn until_next_second(unix_nanos: i64) -> Duration {
    const SECOND: i64 = 1_000_000_000;
    Duration::from_nanos((SECOND - unix_nanos.rem_euclid(SECOND)).unsigned_abs())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_next_second_is_never_now_and_never_more_than_a_second_away() {
        assert_eq!(until_next_second(0), Duration::from_secs(1));
        assert_eq!(until_next_second(1_999_999_999), Duration::from_nanos(1));
        assert_eq!(until_next_second(-1), Duration::from_nanos(1));
    }
}
