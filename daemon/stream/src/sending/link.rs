//! The connection to the aggregator: hello, comparison of both ends' batches, and frames.

use peernet_clock::{MonoTime, Stamp};

use super::super::{
    AGENT_STREAM_VERSIONS, Chain, Hello, HelloExtension, Nonce, Proof, ToAgent, ToAggregator, VersionRange,
    codec,
};
use super::session::{Link, ScanPurpose, Welcome};
use super::spool_reader::{LoadPurpose, ScanResult};
use super::{Notice, Sending};
use crate::spool::SpooledBatch;
use crate::totals::NewestSentBatch;
use peernet_logger::Slug;

/// Returns the reason to refuse an aggregator that chose a version which this agent does not support.
fn wrong_version(aggregator: &Slug, chosen: Option<u16>) -> Option<String> {
    let chosen = VersionRange::single(chosen.unwrap_or(AGENT_STREAM_VERSIONS.oldest()));
    let mismatch = AGENT_STREAM_VERSIONS.highest_common(&chosen).err()?;
    Some(mismatch.describe("the event stream", "this agent", &format!("the aggregator on {aggregator}")))
}

impl Sending {
    /// Records that the transport has a connection.
    pub fn connected(&mut self, now: MonoTime) {
        // The new connection may use another path.
        self.lane.restart();
        self.lane.take_back();
        self.session.connect(now);
    }

    /// Records that the connection ended. Batches in flight count as not sent.
    pub fn disconnected(&mut self) {
        self.session.disconnect();
        self.lane.take_back();
    }

    /// Handles a message from the aggregator.
    pub fn received(&mut self, message: &ToAgent, now: Stamp) -> Option<Notice> {
        match message {
            _ if matches!(self.session.link, Link::Down) => {}
            // Answers to messages of a stream that has been left, or is being left.
            ToAgent::Challenge { stream, .. }
            | ToAgent::Welcome { stream, .. }
            | ToAgent::Ack { stream, .. }
            | ToAgent::Resend { stream, .. }
                if *stream != self.spooler.backlog.origin.stream || self.renewal.is_wanted() => {}
            ToAgent::Challenge { aggregator, nonce, enrol, version, .. } => {
                match wrong_version(aggregator, *version) {
                    Some(reason) => self.refused(&reason, now.mono),
                    None => self.challenged(aggregator, nonce, *enrol, *version, now.mono),
                }
            }
            ToAgent::Welcome { aggregator, stored, chain, process, window, .. } => {
                self.answered(now.mono);
                let (aggregator, chain, process) = (aggregator.clone(), *chain, *process);
                self.lane.allowed(*window);
                self.welcomed(Welcome { aggregator, stored: *stored, chain, process }, now);
            }
            ToAgent::Ack { through, window, .. } => {
                self.lane.allowed(*window);
                self.acknowledged_through(*through, now);
            }
            ToAgent::Resend { from, .. } => self.resend_from(*from, now.mono),
            ToAgent::Echo { bytes } => {
                self.lane.echoed(*bytes, now.mono);
            }
            ToAgent::Refused { reason } => self.refused(reason, now.mono),
            ToAgent::Unknown if self.is_up() => self.schedule_hello(now.mono),
            ToAgent::Unknown => {}
        }
        self.notice()
    }

    /// Returns the frame to be sent now, if any.
    pub(super) fn frame(&mut self, now: MonoTime) -> Option<Vec<u8>> {
        if let Some(proof) = self.session.take_proof() {
            return Some(proof);
        }
        if !self.renewal.is_wanted() && self.session.take_hello(now) {
            return Some(codec::encode(&ToAggregator::Hello(self.hello())));
        }
        let Link::Up { next, heard } = self.session.link else { return None };
        let output = self.lane.next(next, &mut self.spooler, self.host.id, now);
        if output.begins {
            // The timeout begins when there is something to wait for.
            let idle = next == self.spooler.backlog.oldest();
            self.session.link = Link::Up { next: next + 1, heard: if idle { now } else { heard } };
        }
        output.frame
    }

    /// Records an answer to a hello or a proof, and its round trip.
    fn answered(&mut self, now: MonoTime) {
        if let Some(took) = self.session.answered(now) {
            self.lane.round_trip(took, now);
        }
    }

    /// Returns the time at which the connection needs attention without an event.
    pub(super) fn link_deadline(&self) -> Option<MonoTime> {
        if let Some(again) = self.session.hello_at() {
            return (!self.renewal.is_wanted()).then_some(again);
        }
        let reminder = self.lane.remind_at().filter(|_| self.is_up());
        self.patience_ends().into_iter().chain(reminder).min()
    }

    /// Sends a hello again if nothing was acknowledged for too long.
    pub(super) fn check_patience(&mut self, now: MonoTime) {
        if self.patience_ends().is_some_and(|limit| now >= limit) {
            self.schedule_hello(now);
        }
    }

    fn patience_ends(&self) -> Option<MonoTime> {
        self.session.patience_ends(self.spooler.backlog.oldest(), self.lane.progress())
    }

    /// Schedules a hello: at once, unless several had no effect.
    pub(super) fn schedule_hello(&mut self, now: MonoTime) {
        self.lane.take_back();
        self.session.schedule_hello(now);
    }

    fn hello(&self) -> Hello {
        let (_, before) = self.spooler.backlog.acknowledged();
        Hello {
            protocol: AGENT_STREAM_VERSIONS.oldest(),
            host: self.host.clone(),
            stream: self.spooler.backlog.origin.stream,
            previous: self.spooler.backlog.origin.previous,
            first: self.spooler.backlog.origin.first,
            oldest: self.spooler.backlog.oldest(),
            before,
            events_before_oldest: self.spooler.backlog.stored(),
            events_before_first: self.spooler.backlog.origin.events_before_first,
            batch_bytes: u32::try_from(self.config.batch_bytes).unwrap_or(u32::MAX),
            process: self.spooler.process(),
            extension: HelloExtension::from_versions(&AGENT_STREAM_VERSIONS),
        }
    }

    /// Answers the challenge of the aggregator with a proof.
    fn challenged(
        &mut self,
        aggregator: &Slug,
        nonce: &Nonce,
        enrol: bool,
        version: Option<u16>,
        now: MonoTime,
    ) {
        if !self.session.challenged(now) {
            return;
        }
        self.session.choose(version.unwrap_or(AGENT_STREAM_VERSIONS.oldest()));
        self.answered(now);
        let code = self.secret.prove(nonce, &self.hello(), aggregator);
        let secret = enrol.then(|| self.secret.clone());
        self.session.prove(codec::encode(&ToAggregator::Proof(Proof {
            host: self.host.id,
            nonce: *nonce,
            code,
            secret,
        })));
        if enrol {
            self.notices.push_back(Notice::Enrolling { aggregator: aggregator.clone() });
        }
    }

    fn refused(&mut self, reason: &str, now: MonoTime) {
        self.session.refused(now);
        self.notices.push_back(Notice::Refused(reason.to_owned()));
    }

    fn resend_from(&mut self, from: u64, now: MonoTime) {
        let Link::Up { next, heard } = self.session.link else { return };
        if from < self.spooler.backlog.oldest() {
            // The aggregator lacks batches that are no longer here. The hello states so, and the aggregator records the
            // gap.
            self.schedule_hello(now);
        } else {
            self.session.link = Link::Up { next: next.min(from), heard };
            self.lane.lost(from);
        }
    }

    fn acknowledged_through(&mut self, through: u64, now: Stamp) {
        let Link::Up { next, .. } = self.session.link else { return };
        if through > self.spooler.backlog.sent() {
            // Batches that were not sent cannot be stored. The hello finds out what the aggregator has.
            self.schedule_hello(now.mono);
        } else if through >= self.spooler.backlog.oldest() {
            self.session.progressed(next.max(through + 1), now.mono);
            self.acknowledged(through, None, now);
            self.pass_gap(now);
        }
    }

    /// Handles a welcome: the aggregator has batches up to a number, and this end's batch with that number must be the
    /// same.
    fn welcomed(&mut self, mut welcome: Welcome, now: Stamp) {
        welcome.stored = welcome.stored.max(self.spooler.backlog.origin.first - 1);
        let (acknowledged, _) = self.spooler.backlog.acknowledged();
        match self.session.link {
            Link::Greeting { .. } => {}
            // This is the answer to a second hello that was in flight.
            Link::Up { .. } if welcome.stored > acknowledged => {
                return match self.spooler.backlog.chain(welcome.stored) {
                    ours if ours == welcome.chain => self.acknowledged_through(welcome.stored, now),
                    _ => self.schedule_hello(now.mono),
                };
            }
            _ => return,
        }
        // The welcome states whether the batches of an earlier process are stored, also if the stream is left below.
        self.spooler.resolve_earlier(welcome.stored, welcome.process);
        if welcome.stored > self.spooler.backlog.newest() {
            return self.leave_stream(&welcome, now);
        }
        if welcome.stored < acknowledged {
            return match self.has_sent(&welcome) {
                true => self.begin_sending(welcome, true, now),
                false => self.leave_stream(&welcome, now),
            };
        }
        match self.spooler.backlog.known(welcome.stored) {
            Some((chain, scanned)) => self.compare_chains(welcome, Some(chain), scanned, now),
            None => {
                let scan = self.spooler.backlog.scan_to(welcome.stored);
                self.session.link = Link::Comparing { scan, purpose: ScanPurpose::Compare(welcome) };
            }
        }
    }

    /// Continues after the file was read up to `through`. `scanned` is `None` if that batch was not in it.
    fn compared(&mut self, through: u64, scanned: Option<ScanResult>, purpose: ScanPurpose, now: Stamp) {
        match purpose {
            ScanPurpose::Compare(welcome) => {
                let chain = match scanned {
                    Some((_, chain)) if welcome.stored == through => Some(chain),
                    Some(_) => self.spooler.backlog.chain(welcome.stored),
                    None => None,
                };
                self.compare_chains(welcome, chain, scanned, now);
            }
            ScanPurpose::Leave => {
                if scanned.is_some() {
                    self.acknowledged(through, scanned, now);
                }
                self.renew_stream(now.mono);
            }
        }
    }

    /// Starts sending if the aggregator's last batch is the one with the chain `ours`, and leaves the stream otherwise.
    fn compare_chains(
        &mut self,
        welcome: Welcome,
        ours: Option<Chain>,
        scanned: Option<ScanResult>,
        now: Stamp,
    ) {
        let (acknowledged, _) = self.spooler.backlog.acknowledged();
        // The aggregator has no batch of this stream, or no chain of the acknowledged one.
        let nothing_to_compare = welcome.stored < self.spooler.backlog.origin.first
            || welcome.stored == acknowledged && welcome.chain.is_none();
        if nothing_to_compare || ours.is_some() && ours == welcome.chain {
            if welcome.stored > acknowledged {
                self.acknowledged(welcome.stored, scanned, now);
            }
            self.begin_sending(welcome, false, now);
        } else {
            self.leave_stream(&welcome, now);
        }
    }

    /// Returns whether this process or an earlier one sent the aggregator's last batch, which is no longer here. An
    /// older database may contain batches from a copy of the spool, which this spool does not continue.
    fn has_sent(&self, welcome: &Welcome) -> bool {
        let by = |reached: &NewestSentBatch| {
            Some(reached.process) == welcome.process && reached.number >= welcome.stored
        };
        welcome.chain.is_none()
            || welcome.process == Some(self.spooler.process())
            || self.renewal.reached_before().iter().any(by)
    }

    fn begin_sending(&mut self, welcome: Welcome, lacks: bool, now: Stamp) {
        self.spooler.meet();
        self.session.link = Link::Up { next: self.spooler.backlog.oldest(), heard: now.mono };
        let Welcome { aggregator, stored, .. } = welcome;
        self.notices.push_back(Notice::Welcomed { aggregator, stored, lacks });
        self.pass_gap(now);
    }

    /// Leaves the stream, because the aggregator's batches differ from those of this spool.
    ///
    /// If the aggregator's last batch came from a process that wrote to this spool, everything that the spool holds
    /// from that process is stored ([`NewestSentBatch`]): the spool lost its end, or is a copy that the process continued from.
    /// Later batches of the spool were never stored. If the batch came from another process, the spool is a copy of
    /// unknown age, and everything in it is sent: it is better to store events twice, in two streams, than not at all.
    fn leave_stream(&mut self, welcome: &Welcome, now: Stamp) {
        let (stored, newest) = (welcome.stored, self.spooler.backlog.newest());
        self.notices.push_back(Notice::StreamRenewed { stored, newest });
        let reached =
            self.renewal.reached_before().iter().find(|reached| Some(reached.process) == welcome.process);
        // An aggregator that has less than that, but a different batch, contradicts itself.
        let common =
            reached.filter(|reached| stored > reached.number).map_or(0, |reached| reached.number.min(newest));
        // Nothing that the spool still holds is known to be stored.
        if common < self.spooler.backlog.oldest() {
            return self.renew_stream(now.mono);
        }
        match self.spooler.backlog.known(common) {
            Some((_, scanned)) => {
                self.acknowledged(common, scanned, now);
                self.renew_stream(now.mono);
            }
            None => {
                let scan = self.spooler.backlog.scan_to(common);
                self.session.link = Link::Comparing { scan, purpose: ScanPurpose::Leave };
            }
        }
    }

    fn renew_stream(&mut self, now: MonoTime) {
        self.renewal.want();
        self.schedule_hello(now);
    }

    /// Handles batches that were read from the spool.
    pub(super) fn read(&mut self, loading: LoadPurpose, batches: Vec<SpooledBatch>, now: Stamp) {
        match loading {
            LoadPurpose::Scan(from) => self.scanned(from, &batches, now),
            LoadPurpose::Probe(from) => {
                if self.reader.probed(from, &batches, &self.spooler.backlog) {
                    self.pass_gap(now);
                }
            }
            LoadPurpose::Ahead(from) => self.read_ahead(from, batches, now),
        }
    }

    /// Handles batches that were read to be sent.
    fn read_ahead(&mut self, from: u64, batches: Vec<SpooledBatch>, now: Stamp) {
        let backlog = &mut self.spooler.backlog;
        let expected = from == backlog.unknown() && from <= backlog.spooled();
        // The aggregator stored the batches meanwhile, or they are about to be counted.
        if !expected || self.session.is_comparing() {
            return;
        }
        if backlog.loaded(batches) == 0 {
            self.reader.open_gap(from + 1, backlog);
            self.pass_gap(now);
        }
        self.spooler.settle(now);
    }

    /// Handles batches that were read to be counted.
    fn scanned(&mut self, from: u64, batches: &[SpooledBatch], now: Stamp) {
        let Link::Comparing { scan, .. } = &mut self.session.link else { return };
        if !scan.count(from, batches) {
            return;
        }
        let link = std::mem::replace(&mut self.session.link, Link::Down);
        if let Link::Comparing { scan, purpose } = link {
            self.compared(scan.through(), scan.result(), purpose, now);
        }
    }

    /// Continues after a gap in the spool once everything before it is stored by the aggregator.
    fn pass_gap(&mut self, now: Stamp) {
        if self.session.is_comparing() {
            return;
        }
        let Some((resume, before)) = self.reader.pass_gap(&self.spooler.backlog) else { return };
        self.spooler.skip_to(resume, before, now.mono);
        if self.is_up() {
            self.schedule_hello(now.mono);
        }
        self.spooler.settle(now);
    }

    /// Frees the batches up to `through`, which the aggregator stored.
    fn acknowledged(&mut self, through: u64, scanned: Option<ScanResult>, now: Stamp) {
        if scanned.is_some() {
            // The gap was passed, or will be found again.
            self.reader.forget_gap();
        }
        self.spooler.acknowledged(through, scanned, now);
        self.lane.acknowledged(through, now.mono);
    }
}
