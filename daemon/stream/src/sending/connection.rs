//! The connection to the aggregator: hello, comparison of both ends' batches, and frames.

use peernet_clock::{MonoTime, Stamp};

use super::super::{
    AGENT_STREAM_VERSIONS, ChainHash, Hello, HelloExtension, Nonce, Proof, ToAgent, ToAggregator,
    VersionRange, codec,
};
use super::session::{ConnectionState, ScanPurpose, Welcome};
use super::spool_reader::{LoadPurpose, ScanResult};
use super::{Notice, Sending};
use crate::spool::SpooledBatch;
use crate::totals::NewestSendableBatch;
use peernet_logger::Slug;

/// Returns the reason to refuse an aggregator that chose a version which this agent does not support.
fn version_mismatch(aggregator: &Slug, chosen: Option<u16>) -> Option<String> {
    let chosen = VersionRange::single(chosen.unwrap_or(AGENT_STREAM_VERSIONS.oldest()));
    let mismatch = AGENT_STREAM_VERSIONS.highest_common(&chosen).err()?;
    Some(mismatch.describe("the event stream", "this agent", &format!("the aggregator on {aggregator}")))
}

impl Sending {
    /// Records that the transport has a connection.
    pub fn on_connected(&mut self, now: MonoTime) {
        // The new connection may use another path.
        self.durable_lane.restart();
        self.durable_lane.reset_in_flight();
        self.session.connect(now);
    }

    /// Records that the connection ended. Batches in flight count as not sent.
    pub fn on_disconnected(&mut self) {
        self.session.disconnect();
        self.durable_lane.reset_in_flight();
    }

    /// Handles a message from the aggregator.
    pub fn on_message(&mut self, message: &ToAgent, now: Stamp) -> Option<Notice> {
        match message {
            // The message is of a connection that has ended meanwhile.
            _ if matches!(self.session.state, ConnectionState::Down) => {}
            // The message answers a message of a stream that this agent has left or is leaving.
            ToAgent::Challenge { stream, .. }
            | ToAgent::Welcome { stream, .. }
            | ToAgent::Ack { stream, .. }
            | ToAgent::Resend { stream, .. }
                if *stream != self.spooler.backlog.origin.stream || self.renewal.is_requested() => {}
            ToAgent::Challenge { aggregator, nonce, enrol, version, .. } => {
                match version_mismatch(aggregator, *version) {
                    Some(reason) => self.handle_refusal(&reason, now.mono),
                    None => self.handle_challenge(aggregator, nonce, *enrol, *version, now.mono),
                }
            }
            ToAgent::Welcome { aggregator, stored, chain, process, window, .. } => {
                self.record_answer(now.mono);
                let (aggregator, chain, process) = (aggregator.clone(), *chain, *process);
                self.durable_lane.set_window(*window);
                self.handle_welcome(Welcome { aggregator, last_stored: *stored, chain, process }, now);
            }
            ToAgent::Ack { through, window, .. } => {
                self.durable_lane.set_window(*window);
                self.handle_ack(*through, now);
            }
            ToAgent::Resend { from, .. } => self.handle_resend(*from, now.mono),
            ToAgent::Echo { bytes } => {
                self.durable_lane.record_echo(*bytes, now.mono);
            }
            ToAgent::Refused { reason } => self.handle_refusal(reason, now.mono),
            // In any other state, a hello is due or was just answered.
            ToAgent::Unknown if self.is_up() => self.schedule_hello(now.mono),
            ToAgent::Unknown => {}
        }
        self.next_notice()
    }

    /// Returns the frame to be sent now, if any.
    pub(super) fn frame(&mut self, now: MonoTime) -> Option<Vec<u8>> {
        if let Some(proof) = self.session.take_proof() {
            return Some(proof);
        }
        if !self.renewal.is_requested() && self.session.take_hello(now) {
            return Some(codec::encode(&ToAggregator::Hello(self.hello())));
        }
        let ConnectionState::Up { next, last_progress } = self.session.state else { return None };
        let output = self.durable_lane.next(next, &mut self.spooler, self.host.id, now);
        if output.starts_batch {
            // The timeout of acknowledgements starts with the first batch in flight.
            let is_first_in_flight = next == self.spooler.backlog.oldest();
            self.session.state = ConnectionState::Up {
                next: next + 1,
                last_progress: if is_first_in_flight { now } else { last_progress },
            };
        }
        output.frame
    }

    /// Records an answer to a hello or a proof, and its round trip.
    fn record_answer(&mut self, now: MonoTime) {
        if let Some(round_trip) = self.session.record_answer(now) {
            self.durable_lane.observe_round_trip(round_trip, now);
        }
    }

    /// Returns the time at which the connection has something to do even if no event or message arrives.
    pub(super) fn connection_deadline(&self) -> Option<MonoTime> {
        if let Some(retry_at) = self.session.hello_at() {
            return (!self.renewal.is_requested()).then_some(retry_at);
        }
        let echo_retry = self.durable_lane.echo_retry_at().filter(|_| self.is_up());
        self.ack_deadline().into_iter().chain(echo_retry).min()
    }

    /// Sends a hello again if nothing was acknowledged for too long.
    pub(super) fn check_ack_timeout(&mut self, now: MonoTime) {
        if self.ack_deadline().is_some_and(|deadline| now >= deadline) {
            self.schedule_hello(now);
        }
    }

    fn ack_deadline(&self) -> Option<MonoTime> {
        self.session.ack_deadline(self.spooler.backlog.oldest(), self.durable_lane.last_arrival_at())
    }

    /// Schedules a hello: now, or after a pause if the last hellos led to no progress.
    pub(super) fn schedule_hello(&mut self, now: MonoTime) {
        self.durable_lane.reset_in_flight();
        self.session.schedule_hello(now);
    }

    fn hello(&self) -> Hello {
        let (_, chain_before_oldest) = self.spooler.backlog.acknowledged();
        Hello {
            protocol: AGENT_STREAM_VERSIONS.oldest(),
            host: self.host.clone(),
            stream: self.spooler.backlog.origin.stream,
            previous_stream: self.spooler.backlog.origin.previous_stream,
            first: self.spooler.backlog.origin.first,
            oldest: self.spooler.backlog.oldest(),
            chain_before_oldest,
            events_before_oldest: self.spooler.backlog.stored_events(),
            events_before_first: self.spooler.backlog.origin.events_before_first,
            batch_bytes: u32::try_from(self.config.batch_bytes).unwrap_or(u32::MAX),
            process: self.spooler.process(),
            extension: HelloExtension::from_versions(&AGENT_STREAM_VERSIONS),
        }
    }

    /// Answers the challenge of the aggregator with a proof.
    fn handle_challenge(
        &mut self,
        aggregator: &Slug,
        nonce: &Nonce,
        enrol: bool,
        version: Option<u16>,
        now: MonoTime,
    ) {
        if !self.session.record_challenge(now) {
            return;
        }
        self.session.set_version(version.unwrap_or(AGENT_STREAM_VERSIONS.oldest()));
        self.record_answer(now);
        let code = self.secret.prove(nonce, &self.hello(), aggregator);
        let secret = enrol.then(|| self.secret.clone());
        self.session.queue_proof(codec::encode(&ToAggregator::Proof(Proof {
            host: self.host.id,
            nonce: *nonce,
            code,
            secret,
        })));
        if enrol {
            self.notices.push_back(Notice::Enrolling { aggregator: aggregator.clone() });
        }
    }

    fn handle_refusal(&mut self, reason: &str, now: MonoTime) {
        // A refusal may arrive after a welcome. Batches in flight are sent again after the next welcome.
        self.durable_lane.reset_in_flight();
        self.session.record_refusal(now);
        self.notices.push_back(Notice::Refused(reason.to_owned()));
    }

    fn handle_resend(&mut self, from: u64, now: MonoTime) {
        let ConnectionState::Up { next, last_progress } = self.session.state else { return };
        if from < self.spooler.backlog.oldest() {
            // The aggregator lacks batches that this agent no longer holds. The hello states the oldest batch that this
            // agent holds, and the aggregator records a gap.
            self.schedule_hello(now);
        } else {
            self.session.state = ConnectionState::Up { next: next.min(from), last_progress };
            self.durable_lane.mark_lost(from);
        }
    }

    fn handle_ack(&mut self, through: u64, now: Stamp) {
        let ConnectionState::Up { next, .. } = self.session.state else { return };
        if through > self.spooler.backlog.newest_sent() {
            // Batches that were not sent cannot be stored. The answer to the hello states what the aggregator has
            // stored.
            self.schedule_hello(now.mono);
        } else if through >= self.spooler.backlog.oldest() {
            // After a request to send batches again, `next` may be the number of a batch that was stored meanwhile.
            self.session.record_progress(next.max(through + 1), now.mono);
            self.free_acknowledged(through, None, now);
            self.pass_gap(now);
        }
    }

    /// Handles a welcome. The aggregator's last batch is compared with this agent's batch of the same number.
    fn handle_welcome(&mut self, mut welcome: Welcome, now: Stamp) {
        // By the protocol, the aggregator states at least this number. This agent does not rely on it.
        welcome.last_stored = welcome.last_stored.max(self.spooler.backlog.origin.first - 1);
        let (acknowledged, _) = self.spooler.backlog.acknowledged();
        match self.session.state {
            ConnectionState::Handshake { .. } => {}
            // This welcome answers a second hello that was in flight.
            ConnectionState::Up { .. } if welcome.last_stored > acknowledged => {
                return match self.spooler.backlog.chain(welcome.last_stored) {
                    own_chain if own_chain == welcome.chain => self.handle_ack(welcome.last_stored, now),
                    _ => self.schedule_hello(now.mono),
                };
            }
            _ => return,
        }
        // The welcome states whether the batches of an earlier process are stored, even if this agent leaves the stream
        // afterwards.
        self.spooler.resolve_earlier(welcome.last_stored, welcome.process);
        if welcome.last_stored > self.spooler.backlog.newest() {
            return self.leave_stream(&welcome, now);
        }
        if welcome.last_stored < acknowledged {
            return match self.has_sent_last_stored(&welcome) {
                true => {
                    let aggregator_lost_batches = true;
                    self.begin_sending(welcome, aggregator_lost_batches, now);
                }
                false => self.leave_stream(&welcome, now),
            };
        }
        match self.spooler.backlog.find_in_memory(welcome.last_stored) {
            Some((chain, scanned)) => self.compare_chains(welcome, Some(chain), scanned, now),
            None => {
                let scan = self.spooler.backlog.scan_to(welcome.last_stored);
                self.session.state =
                    ConnectionState::Scanning { scan, purpose: ScanPurpose::Compare(welcome) };
            }
        }
    }

    /// Continues the comparison or the leaving of the stream after the file was read up to batch `through`. `scanned`
    /// is `None` if that batch was not in the file.
    fn finish_comparison(
        &mut self,
        through: u64,
        scanned: Option<ScanResult>,
        purpose: ScanPurpose,
        now: Stamp,
    ) {
        match purpose {
            ScanPurpose::Compare(welcome) => {
                let chain = match scanned {
                    Some((_, chain)) if welcome.last_stored == through => Some(chain),
                    // The scan reached the end of the file. The aggregator's last batch is newer and is in memory.
                    Some(_) => self.spooler.backlog.chain(welcome.last_stored),
                    None => None,
                };
                self.compare_chains(welcome, chain, scanned, now);
            }
            ScanPurpose::Leave => {
                if scanned.is_some() {
                    self.free_acknowledged(through, scanned, now);
                }
                self.renew_stream(now.mono);
            }
        }
    }

    /// Starts sending if the chain hash of the aggregator's last batch equals `own_chain`, and leaves the stream
    /// otherwise.
    fn compare_chains(
        &mut self,
        welcome: Welcome,
        own_chain: Option<ChainHash>,
        scanned: Option<ScanResult>,
        now: Stamp,
    ) {
        let (acknowledged, _) = self.spooler.backlog.acknowledged();
        // The aggregator has no batch of this stream, or does not know the chain hash of the last acknowledged batch.
        let nothing_to_compare = welcome.last_stored < self.spooler.backlog.origin.first
            || welcome.last_stored == acknowledged && welcome.chain.is_none();
        if nothing_to_compare || own_chain.is_some() && own_chain == welcome.chain {
            if welcome.last_stored > acknowledged {
                self.free_acknowledged(welcome.last_stored, scanned, now);
            }
            let aggregator_lost_batches = false;
            self.begin_sending(welcome, aggregator_lost_batches, now);
        } else {
            self.leave_stream(&welcome, now);
        }
    }

    /// Returns whether this process or an earlier process of this spool sent the aggregator's last batch, which the
    /// spool no longer contains. If not, a process with a copy of this spool sent that batch. The aggregator's database
    /// may then be a backup from a time when the aggregator received the batches of that copy.
    fn has_sent_last_stored(&self, welcome: &Welcome) -> bool {
        let is_sender = |newest_sendable: &NewestSendableBatch| {
            Some(newest_sendable.process) == welcome.process && newest_sendable.number >= welcome.last_stored
        };
        // Without a chain hash, the aggregator has no batch of this stream, and therefore none of a copy.
        welcome.chain.is_none()
            || welcome.process == Some(self.spooler.process())
            || self.renewal.newest_sendable_of_earlier_processes().iter().any(is_sender)
    }

    fn begin_sending(&mut self, welcome: Welcome, aggregator_lost_batches: bool, now: Stamp) {
        self.spooler.record_acceptance();
        self.session.state =
            ConnectionState::Up { next: self.spooler.backlog.oldest(), last_progress: now.mono };
        let Welcome { aggregator, last_stored, .. } = welcome;
        self.notices.push_back(Notice::Welcomed { aggregator, stored: last_stored, aggregator_lost_batches });
        self.pass_gap(now);
    }

    /// Leaves the stream, because the aggregator's batches differ from this spool's batches.
    ///
    /// The process that sent the aggregator's last batch decides what is known:
    ///
    /// - The process wrote to this spool. The spool then lost its last batches, or the spool is a copy that was made
    ///   before that process wrote its last batches to the original. All batches that this spool has from the process
    ///   are stored ([`NewestSendableBatch`]). Later batches of the spool were never stored.
    /// - The process never wrote to this spool. The spool is then a copy of unknown age. All its batches are sent,
    ///   because it is better to store events twice, in two streams, than not at all.
    fn leave_stream(&mut self, welcome: &Welcome, now: Stamp) {
        let (last_stored, newest) = (welcome.last_stored, self.spooler.backlog.newest());
        self.notices.push_back(Notice::StreamRenewed { stored: last_stored, newest });
        let newest_sendable = self
            .renewal
            .newest_sendable_of_earlier_processes()
            .iter()
            .find(|newest_sendable| Some(newest_sendable.process) == welcome.process);
        // If the spool contains the record that the process was allowed to send batch `last_stored`, but the aggregator
        // has a different batch with this number, no batch is certain to be stored.
        let last_common = newest_sendable
            .filter(|newest_sendable| last_stored > newest_sendable.number)
            .map_or(0, |newest_sendable| newest_sendable.number.min(newest));
        // No batch that the spool still holds is known to be stored.
        if last_common < self.spooler.backlog.oldest() {
            return self.renew_stream(now.mono);
        }
        match self.spooler.backlog.find_in_memory(last_common) {
            Some((_, scanned)) => {
                self.free_acknowledged(last_common, scanned, now);
                self.renew_stream(now.mono);
            }
            None => {
                let scan = self.spooler.backlog.scan_to(last_common);
                self.session.state = ConnectionState::Scanning { scan, purpose: ScanPurpose::Leave };
            }
        }
    }

    fn renew_stream(&mut self, now: MonoTime) {
        self.renewal.request();
        self.schedule_hello(now);
    }

    /// Handles batches that were read from the spool.
    pub(super) fn handle_loaded(&mut self, purpose: LoadPurpose, batches: Vec<SpooledBatch>, now: Stamp) {
        match purpose {
            LoadPurpose::Scan(from) => self.handle_scan(from, &batches, now),
            LoadPurpose::GapSearch(from) => {
                if self.reader.handle_gap_search(from, &batches, &self.spooler.backlog) {
                    self.pass_gap(now);
                }
            }
            LoadPurpose::ReadAhead(from) => self.handle_read_ahead(from, batches, now),
        }
    }

    /// Handles batches that were read to be sent.
    fn handle_read_ahead(&mut self, from: u64, batches: Vec<SpooledBatch>, now: Stamp) {
        let backlog = &mut self.spooler.backlog;
        let is_expected = from == backlog.first_unloaded() && from <= backlog.spooled();
        // The aggregator stored the batches meanwhile, or a scan is about to read them.
        if !is_expected || self.session.is_scanning() {
            return;
        }
        if backlog.add_loaded(batches) == 0 {
            // Batch `from` is missing, so the search for the end of the gap begins after it.
            self.reader.open_gap(from + 1, backlog);
            self.pass_gap(now);
        }
        self.spooler.drop_missing(now);
    }

    /// Handles batches that were read for a scan, which compares chain hashes or precedes the leaving of the stream.
    fn handle_scan(&mut self, from: u64, batches: &[SpooledBatch], now: Stamp) {
        let ConnectionState::Scanning { scan, .. } = &mut self.session.state else { return };
        if !scan.count(from, batches) {
            return;
        }
        // `finish_comparison` sets the next state.
        let state = std::mem::replace(&mut self.session.state, ConnectionState::Down);
        if let ConnectionState::Scanning { scan, purpose } = state {
            self.finish_comparison(scan.through(), scan.result(), purpose, now);
        }
    }

    /// Continues after a gap in the spool as soon as the aggregator has stored everything before the gap.
    fn pass_gap(&mut self, now: Stamp) {
        if self.session.is_scanning() {
            return;
        }
        let Some((resume, previous_chain)) = self.reader.pass_gap(&self.spooler.backlog) else { return };
        self.spooler.skip_to(resume, previous_chain, now.mono);
        if self.is_up() {
            self.schedule_hello(now.mono);
        }
        self.spooler.drop_missing(now);
    }

    /// Frees the batches up to `through`, which the aggregator stored.
    fn free_acknowledged(&mut self, through: u64, scanned: Option<ScanResult>, now: Stamp) {
        if scanned.is_some() {
            // If a gap is known, it begins at or before batch `through`. Any other gap will be found again.
            self.reader.forget_gap();
        }
        self.spooler.free_acknowledged(through, scanned, now);
        self.durable_lane.record_ack(through, now.mono);
    }
}
