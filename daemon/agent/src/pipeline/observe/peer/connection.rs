//! The connection to the agent that observes the same messages.

use std::net::IpAddr;
use std::sync::Arc;
use std::time::Duration;

use peernet_clock::{MonoTime, OneWayDelay, SharedClock};
use peernet_logger::{HostId, Recorder, Slug};
use peernet_networks::{Address, CloseReason, SessionSettings};
use peernet_sample::Sample;
use peernet_stream::{IncidentKind, Outcome, PipelineState};

use super::PeerDescription;
use crate::config::{ObserveConfig, PairBy, RemoteConfig};
use crate::host::Host;
use crate::incidents::IncidentSubject;
use crate::link::TransitStamps;
use crate::observed::{STAMPS_MODEL, StampAnswer, StampRequest};
use crate::pipeline::context::PipelineContext;
use crate::pipeline::peer_problem::PeerProblem;
use crate::pipeline::placement::{OpenFailure, Placement};
use crate::pipeline::runner::Runner;
use crate::reconnect_backoff::ReconnectBackoff;

/// Opens connections to the peer.
pub(super) struct PeerConnector {
    context: PipelineContext,
    /// Pipeline of this host.
    pipeline: Slug,
    /// Pipeline of the peer.
    peer_pipeline: Slug,
    pair_by: PairBy,
    remote: RemoteConfig,
    /// Longest wait for the answer to a query: the `timeout_ms` of the pipeline.
    answer_timeout: Duration,
}

/// A connection to the peer: a session that is used to query stamps.
pub(super) struct PeerConnection {
    placement: Placement,
    pub(super) host: HostId,
    pub(super) name: Slug,
    peer_pipeline: Slug,
    pair_by: PairBy,
    address: Address,
    clock: SharedClock,
    own_host: HostId,
    answer_timeout: Duration,
}

impl PeerConnector {
    /// Creates a connector; `None` if the pipeline has no peer.
    pub(super) fn new(runner: &Runner, config: &ObserveConfig) -> Option<Self> {
        let remote = RemoteConfig {
            peer: config.peer.clone()?,
            network: None,
            // A peer answers a request for this model with observed stamps.
            model: STAMPS_MODEL.parse().ok(),
            device: None,
            session: SessionSettings::default(),
        };
        let pipeline = runner.config.name.clone();
        Some(Self {
            context: runner.context.clone(),
            peer_pipeline: config.peer_pipeline.clone().unwrap_or_else(|| pipeline.clone()),
            pipeline,
            pair_by: config.pair_by,
            remote,
            answer_timeout: runner.config.timeout(),
        })
    }

    /// Opens the first connection, for which the start of the run waits, and retries until that succeeds. Returns
    /// `None` if the agent stops.
    pub(super) async fn connect_first(&self, runner: &Runner) -> Option<PeerConnection> {
        let mut reconnect_backoff = ReconnectBackoff::new(self.context.host.id);
        let mut reported_problem = None;
        loop {
            let problem = match runner.stop.run_until_cancelled(self.open()).await? {
                Ok(connection) => return Some(connection),
                Err(problem) => problem,
            };
            runner.live_state.set_state(PipelineState::Waiting(problem.text().to_owned()));
            let pause = problem.pause(&mut reconnect_backoff);
            if !problem.is_covered_by(reported_problem.as_ref()) {
                let text = format!("{}; the run starts when the peer answers", problem.describe());
                let unknown_peer = None;
                self.report(problem.kind(), unknown_peer, text);
                reported_problem = Some(problem);
            }
            runner.stop.run_until_cancelled(tokio::time::sleep(pause)).await?;
        }
    }

    /// Opens a connection and checks that the peer has the pipeline.
    pub(super) async fn open(&self) -> Result<PeerConnection, PeerProblem> {
        let settings = self.remote.session.clone();
        let placement = Placement::open_remote(&self.remote, settings, &self.pipeline, &self.context).await;
        let placement = placement.map_err(|failure| self.problem_from_failure(failure))?;
        let Some((host, name)) = placement.peer().map(|(host, name)| (host, name.clone())) else {
            let text = format!("{} did not send its host id and name", self.remote.peer);
            return Err(PeerProblem::Unreachable(text));
        };
        let connection = PeerConnection {
            placement,
            host,
            name,
            peer_pipeline: self.peer_pipeline.clone(),
            pair_by: self.pair_by,
            address: self.remote.peer.clone(),
            clock: Arc::clone(&self.context.host.clock),
            own_host: self.context.host.id,
            answer_timeout: self.answer_timeout,
        };
        // A request without keys shows whether the peer has the pipeline.
        match connection.query(Vec::new()).await {
            Ok(_) => {
                let text = format!(
                    "connected to {}, which observes the same messages with its pipeline {}",
                    connection.name, self.peer_pipeline
                );
                self.report(IncidentKind::Connected, Some(connection.host), text);
                Ok(connection)
            }
            Err(problem) => {
                connection.close().await;
                Err(problem)
            }
        }
    }

    fn problem_from_failure(&self, failure: OpenFailure) -> PeerProblem {
        match failure {
            OpenFailure::Unreachable(error) => PeerProblem::Unreachable(error.to_string()),
            OpenFailure::Refused(error) => PeerProblem::Refused(with_advice(error.to_string())),
            // These failures cannot occur here, because a remote placement loads no model on this host.
            OpenFailure::Model(_) | OpenFailure::ModelServerUnreachable(_) | OpenFailure::Panicked => {
                PeerProblem::Unreachable(format!("cannot open a session with {}", self.remote.peer))
            }
        }
    }

    /// Reports an incident of the pipeline, and of its run if one is in progress.
    pub(super) fn report(&self, kind: IncidentKind, peer: Option<HostId>, text: String) {
        let events = &self.context.events;
        let run = events.runs.current_run(&self.pipeline);
        events.incidents.report(kind, IncidentSubject { pipeline: Some(&self.pipeline), run, peer }, text);
    }

    pub(super) const fn host(&self) -> &Host {
        &self.context.host
    }

    /// Returns the name of the peer's pipeline.
    pub(super) const fn peer_pipeline(&self) -> &Slug {
        &self.peer_pipeline
    }

    pub(super) const fn answer_timeout(&self) -> Duration {
        self.answer_timeout
    }

    /// Waits until `at`; for ever if `at` is `None`.
    pub(super) async fn sleep_until(&self, at: Option<MonoTime>) {
        match at {
            Some(at) => tokio::time::sleep((at - self.context.host.clock.mono()).to_duration()).await,
            None => std::future::pending().await,
        }
    }
}

impl PeerConnection {
    /// Queries the stamps of messages by their keys.
    ///
    /// # Errors
    /// When the peer does not answer, refuses, or sends an answer that cannot be read.
    pub(super) async fn query(&self, keys: Vec<i64>) -> Result<StampAnswer, PeerProblem> {
        let describe = |reason: String| {
            format!("cannot query the observed stamps of {} at {}: {reason}", self.name, self.address)
        };
        let failure = |reason: String| PeerProblem::Unreachable(describe(reason));
        let refusal = |reason: String| PeerProblem::Refused(describe(reason));
        let request = StampRequest::new(self.peer_pipeline.clone(), self.pair_by, keys);
        let sample = request.to_sample().map_err(|error| refusal(error.to_string()))?;
        // The recorder is required but belongs to no iteration, so its tree is dropped. The request has two uses: its
        // answer, and the exchange of time stamps, from which the clock relation of the link learns.
        let log = Recorder::new(Arc::clone(&self.clock), self.own_host);
        match self.placement.compute(log, &sample, self.answer_timeout).await.result {
            Ok(answer) => {
                // A missing answer is read like an empty one: reading returns an error.
                let answer = answer.unwrap_or_else(empty_sample);
                StampAnswer::read(&answer)
                    .map_err(|error| refusal(format!("the answer cannot be read: {error}")))
            }
            Err(Outcome::Failed(reason)) => Err(refusal(reason)),
            Err(Outcome::Lost(reason)) => Err(failure(reason)),
            // `Outcome::Ok` does not occur as an error.
            Err(Outcome::Timeout(_) | Outcome::Ok) => {
                Err(failure(format!("no answer within {} ms", self.answer_timeout.as_millis())))
            }
        }
    }

    /// Judges the delays of messages by the link's clock relation.
    pub(super) fn judge(&self, up: &TransitStamps, down: Option<&TransitStamps>) -> [Option<OneWayDelay>; 2] {
        self.placement.judge_stamps(up, down)
    }

    /// Returns the description of the peer for the run's page.
    pub(super) async fn peer_description(&self) -> PeerDescription {
        let mut facts =
            vec![("Peer".to_owned(), format!("{} with its pipeline {}", self.name, self.peer_pipeline))];
        facts.extend(self.placement.facts());
        // If the name cannot be resolved, the list is empty: publishers are then not marked as being on the peer's
        // host.
        let lookup = tokio::net::lookup_host((self.address.host(), 0)).await;
        let addresses: Vec<IpAddr> =
            lookup.map(|found| found.map(|socket_address| socket_address.ip()).collect()).unwrap_or_default();
        PeerDescription {
            name: self.name.clone(),
            facts,
            conditions: self.placement.peer_conditions().to_vec(),
            addresses,
        }
    }

    /// Waits until the connection is closed and returns the reason.
    pub(super) async fn closed(&self) -> CloseReason {
        self.placement.closed().await
    }

    pub(super) async fn close(&self) {
        // The peer computes no iterations of the run, so the goodbye contains no number of iterations.
        let planned_iterations = None;
        self.placement.close(planned_iterations).await;
    }
}

/// Returns the text of a refusal. Adds advice if the text of the peer contains none.
fn with_advice(refusal: String) -> String {
    // An agent of an earlier release treats the query as a request for a model with the name `STAMPS_MODEL`.
    if refusal.contains(&format!("no model named {STAMPS_MODEL}")) {
        return format!(
            "{refusal}; the agent of the peer must be PEERNet 0.3 or later, with a [[pipeline]] that observes the same messages"
        );
    }
    refusal
}

fn empty_sample() -> Sample {
    Sample { parts: Vec::new(), source: String::new(), label: None }
}

#[cfg(test)]
mod tests {
    use peernet_inference::LoadError;
    use peernet_networks::OpenError;

    use super::*;

    #[test]
    fn refusal_by_earlier_release_advises_update() {
        let refused = |reason: String| {
            let address = "tcp://rack:5551".parse().expect("an address");
            with_advice(OpenError::Refused { address, reason }.to_string())
        };
        let unknown =
            LoadError::UnknownModel { name: STAMPS_MODEL.to_owned(), known: vec!["echo".to_owned()] };
        let text = refused(unknown.to_peer(STAMPS_MODEL, "cloud"));
        for part in ["tcp://rack:5551", "PEERNet 0.3 or later", "[[pipeline]]"] {
            assert!(text.contains(part), "{text}");
        }
        let other_refusal = refused("host rack observes no topics".to_owned());
        assert!(other_refusal.ends_with("observes no topics"), "{other_refusal}");
    }
}
