//! The connection to the aggregator: the greeting, the comparison of what both ends know, and the frames.

use peernet_clock::{MonoTime, Stamp};

use super::super::{
    AGENT_STREAM_VERSIONS, Chain, Hello, HelloExtension, Nonce, Proof, ToAgent, ToAggregator, VersionRange,
    codec,
};
use super::session::{Link, ScanPurpose, Welcome};
use super::spool_reader::{LoadPurpose, ScanResult};
use super::{Notice, Sending};
use crate::spool::SpooledBatch;
use crate::totals::Reached;
use peernet_logger::Slug;

/// Returns the reason not to answer an aggregator that chose a version which this agent does not speak.
fn wrong_version(aggregator: &Slug, chosen: Option<u16>) -> Option<String> {
    let chosen = VersionRange::single(chosen.unwrap_or(AGENT_STREAM_VERSIONS.oldest()));
    let mismatch = AGENT_STREAM_VERSIONS.highest_common(&chosen).err()?;
    Some(mismatch.describe("the event stream", "this agent", &format!("the aggregator on {aggregator}")))
}

impl Sending {
    /// The transport has a connection.
    pub fn connected(&mut self, now: MonoTime) {
        self.lane.restart();
        self.lane.take_back();
        self.session.connect(now);
    }

    /// The transport has none. Batches under way count as not sent.
    pub fn disconnected(&mut self) {
        self.session.disconnect();
        self.lane.take_back();
    }

    /// A message came.
    pub fn received(&mut self, message: &ToAgent, now: Stamp) -> Option<Notice> {
        match message {
            _ if matches!(self.session.link, Link::Down) => {}
            // Answers to what was sent in a stream that has been left since, or is being left.
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
            ToAgent::Resend { from, .. } => self.asked_again(*from, now.mono),
            ToAgent::Echo { bytes } => {
                self.lane.echoed(*bytes, now.mono);
            }
            ToAgent::Refused { reason } => self.refused(reason, now.mono),
            ToAgent::Unknown if self.is_up() => self.greet_again(now.mono),
            ToAgent::Unknown => {}
        }
        self.notice()
    }

    /// The frame to send now, if there is one.
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
            // Patience begins when there is something to wait for.
            let idle = next == self.spooler.backlog.oldest();
            self.session.link = Link::Up { next: next + 1, heard: if idle { now } else { heard } };
        }
        output.frame
    }

    /// The aggregator answered a greeting.
    fn answered(&mut self, now: MonoTime) {
        if let Some(took) = self.session.answered(now) {
            self.lane.round_trip(took, now);
        }
    }

    /// When the link has something to do without anything else happening.
    pub(super) fn link_deadline(&self) -> Option<MonoTime> {
        if let Some(again) = self.session.hello_at() {
            return (!self.renewal.is_wanted()).then_some(again);
        }
        let reminder = self.lane.remind_at().filter(|_| self.is_up());
        self.patience_ends().into_iter().chain(reminder).min()
    }

    /// Greets again when nothing was acknowledged for too long.
    pub(super) fn lose_patience(&mut self, now: MonoTime) {
        if self.patience_ends().is_some_and(|limit| now >= limit) {
            self.greet_again(now);
        }
    }

    fn patience_ends(&self) -> Option<MonoTime> {
        self.session.patience_ends(self.spooler.backlog.oldest(), self.lane.progress())
    }

    /// Says hello: at once, unless that led to nothing several times.
    pub(super) fn greet_again(&mut self, now: MonoTime) {
        self.lane.take_back();
        self.session.greet_again(now);
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
            extension: HelloExtension::of(&AGENT_STREAM_VERSIONS),
        }
    }

    /// The aggregator asks for the proof that this host is who it says it is.
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

    fn asked_again(&mut self, from: u64, now: MonoTime) {
        let Link::Up { next, heard } = self.session.link else { return };
        if from < self.spooler.backlog.oldest() {
            // It lacks what is no longer here: the hello tells it so, and it records the gap.
            self.greet_again(now);
        } else {
            self.session.link = Link::Up { next: next.min(from), heard };
            self.lane.lost(from);
        }
    }

    fn acknowledged_through(&mut self, through: u64, now: Stamp) {
        let Link::Up { next, .. } = self.session.link else { return };
        if through > self.spooler.backlog.sent() {
            // Nobody can have stored what was not sent: the greeting finds out what there is.
            self.greet_again(now.mono);
        } else if through >= self.spooler.backlog.oldest() {
            self.session.progressed(next.max(through + 1), now.mono);
            self.acknowledged(through, None, now);
            self.pass_gap(now);
        }
    }

    /// The aggregator has batches up to a number. Ours of that number must be the same.
    fn welcomed(&mut self, mut welcome: Welcome, now: Stamp) {
        welcome.stored = welcome.stored.max(self.spooler.backlog.origin.first - 1);
        let (acknowledged, _) = self.spooler.backlog.acknowledged();
        match self.session.link {
            Link::Greeting { .. } => {}
            // The answer to a second hello that was on its way.
            Link::Up { .. } if welcome.stored > acknowledged => {
                return match self.spooler.backlog.chain(welcome.stored) {
                    ours if ours == welcome.chain => self.acknowledged_through(welcome.stored, now),
                    _ => self.greet_again(now.mono),
                };
            }
            _ => return,
        }
        self.spooler.resolve_earlier(welcome.stored, welcome.process);
        if welcome.stored > self.spooler.backlog.newest() {
            return self.leave(&welcome, now);
        }
        if welcome.stored < acknowledged {
            return match self.has_sent(&welcome) {
                true => self.taken_in(welcome, true, now),
                false => self.leave(&welcome, now),
            };
        }
        match self.spooler.backlog.known(welcome.stored) {
            Some((chain, scanned)) => self.judge(welcome, Some(chain), scanned, now),
            None => {
                let scan = self.spooler.backlog.scan_to(welcome.stored);
                self.session.link = Link::Comparing { scan, purpose: ScanPurpose::Compare(welcome) };
            }
        }
    }

    /// The file was read up to `through`; nothing is said of it when that batch was not in it.
    fn compared(&mut self, through: u64, scanned: Option<ScanResult>, purpose: ScanPurpose, now: Stamp) {
        match purpose {
            ScanPurpose::Compare(welcome) => {
                let chain = match scanned {
                    Some((_, chain)) if welcome.stored == through => Some(chain),
                    Some(_) => self.spooler.backlog.chain(welcome.stored),
                    None => None,
                };
                self.judge(welcome, chain, scanned, now);
            }
            ScanPurpose::Leave => {
                if scanned.is_some() {
                    self.acknowledged(through, scanned, now);
                }
                self.renew_stream(now.mono);
            }
        }
    }

    /// Goes on when the aggregator's last batch is ours, of which the chain is `ours`.
    fn judge(&mut self, welcome: Welcome, ours: Option<Chain>, scanned: Option<ScanResult>, now: Stamp) {
        let (acknowledged, _) = self.spooler.backlog.acknowledged();
        let nothing_to_compare = welcome.stored < self.spooler.backlog.origin.first
            || welcome.stored == acknowledged && welcome.chain.is_none();
        if nothing_to_compare || ours.is_some() && ours == welcome.chain {
            if welcome.stored > acknowledged {
                self.acknowledged(welcome.stored, scanned, now);
            }
            self.taken_in(welcome, false, now);
        } else {
            self.leave(&welcome, now);
        }
    }

    /// Whether the aggregator's last batch, which is not here any more, was sent by this process or by one before it.
    /// In an older database there may stand what a copy of the spool sent; what is held does not go on from that.
    fn has_sent(&self, welcome: &Welcome) -> bool {
        let by =
            |reached: &Reached| Some(reached.process) == welcome.process && reached.number >= welcome.stored;
        welcome.chain.is_none()
            || welcome.process == Some(self.spooler.process())
            || self.renewal.reached_before().iter().any(by)
    }

    fn taken_in(&mut self, welcome: Welcome, lacks: bool, now: Stamp) {
        self.spooler.meet();
        self.session.link = Link::Up { next: self.spooler.backlog.oldest(), heard: now.mono };
        let Welcome { aggregator, stored, .. } = welcome;
        self.notices.push_back(Notice::Welcomed { aggregator, stored, lacks });
        self.pass_gap(now);
    }

    /// The aggregator's stream is not ours any more.
    ///
    /// When its last batch came from a process that wrote to this spool, all is stored that the spool holds of that
    /// process ([`Reached`]): either the spool lost its end, or is a copy from which that process went on. What
    /// came into the spool later was never stored. When that batch came from another process, the spool is a copy of
    /// unknown age, and everything that is held is sent: rather twice, in two streams, than not at all.
    fn leave(&mut self, welcome: &Welcome, now: Stamp) {
        let (stored, newest) = (welcome.stored, self.spooler.backlog.newest());
        self.notices.push_back(Notice::StreamRenewed { stored, newest });
        let reached =
            self.renewal.reached_before().iter().find(|reached| Some(reached.process) == welcome.process);
        // An aggregator that has less than that, and something else, contradicts itself.
        let common =
            reached.filter(|reached| stored > reached.number).map_or(0, |reached| reached.number.min(newest));
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
        self.greet_again(now);
    }

    /// Batches came from the spool that were asked for.
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

    /// Batches came that are to be sent.
    fn read_ahead(&mut self, from: u64, batches: Vec<SpooledBatch>, now: Stamp) {
        let backlog = &mut self.spooler.backlog;
        let expected = from == backlog.unknown() && from <= backlog.spooled();
        // Stored over there meanwhile, or about to be counted.
        if !expected || self.session.is_comparing() {
            return;
        }
        if backlog.loaded(batches) == 0 {
            self.reader.open_gap(from + 1, backlog);
            self.pass_gap(now);
        }
        self.spooler.settle(now);
    }

    /// Batches came that are to be counted.
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

    /// Goes on behind a gap in the spool when everything before it is stored over there.
    fn pass_gap(&mut self, now: Stamp) {
        if self.session.is_comparing() {
            return;
        }
        let Some((resume, before)) = self.reader.pass_gap(&self.spooler.backlog) else { return };
        self.spooler.skip_to(resume, before, now.mono);
        if self.is_up() {
            self.greet_again(now.mono);
        }
        self.spooler.settle(now);
    }

    /// All batches up to and including `through` are stored over there.
    fn acknowledged(&mut self, through: u64, scanned: Option<ScanResult>, now: Stamp) {
        if scanned.is_some() {
            // It was passed, or is found again.
            self.reader.forget_gap();
        }
        self.spooler.acknowledged(through, scanned, now);
        self.lane.acknowledged(through, now.mono);
    }
}
