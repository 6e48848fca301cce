//! The connection to the aggregator: the greeting, the comparison of what both ends know, and the frames.

use peernet_clock::{MonoTime, Span, Stamp};

use super::super::{
    Chain, Hello, HelloExtension, Nonce, Proof, STREAM_VERSIONS, StreamId, ToAgent, ToAggregator,
    VersionRange, codec,
};
use super::skim::{Skim, Skimmed};
use super::{Notice, Reached, Sending};
use peernet_logger::Slug;

/// Greetings without any progress that follow one another at once; later ones wait, each longer than the one before.
const PROMPT_GREETINGS: u32 = 3;

/// How far the connection has come.
#[derive(Clone, Debug)]
pub(super) enum Link {
    /// There is none.
    Down,
    /// A hello is due at `again`; `pause` passes before the one after.
    Greeting { again: MonoTime, pause: Span },
    /// Welcomed; the file is read to compare what both ends know.
    Comparing { skim: Skim, then: Then },
    /// Taken in; batch `next` is the next to go. `heard` is when there last was progress.
    Up { next: u64, heard: MonoTime },
}

/// What the file is read for.
#[derive(Clone, Debug)]
pub(super) enum Then {
    /// For the chain of the batch that the aggregator has.
    Compare(Welcome),
    /// For what is taken as stored before the stream is left.
    Leave,
}

/// What the aggregator says it has.
#[derive(Clone, Debug)]
pub(super) struct Welcome {
    aggregator: Slug,
    stored: u64,
    chain: Option<Chain>,
    /// Who sent that batch.
    process: Option<u64>,
}

/// Returns the reason not to answer an aggregator that chose a version which this agent does not speak.
fn wrong_version(aggregator: &Slug, chosen: Option<u16>) -> Option<String> {
    let chosen = VersionRange::single(chosen.unwrap_or(STREAM_VERSIONS.oldest()));
    let mismatch = STREAM_VERSIONS.highest_common(&chosen).err()?;
    Some(mismatch.describe("the event stream", "this agent", &format!("the aggregator on {aggregator}")))
}

impl Sending {
    /// The transport has a connection.
    pub fn connected(&mut self, now: MonoTime) {
        self.greetings = 0;
        self.asked.0 = 0;
        self.flow.restart();
        self.greet_again(now);
    }

    /// The transport has none. Batches under way count as not sent.
    pub fn disconnected(&mut self) {
        self.link = Link::Down;
        self.take_back();
    }

    /// A message came.
    pub fn received(&mut self, message: &ToAgent, now: Stamp) -> Option<Notice> {
        match message {
            _ if matches!(self.link, Link::Down) => {}
            // Answers to what was sent in a stream that has been left since, or is being left.
            ToAgent::Challenge { stream, .. }
            | ToAgent::Welcome { stream, .. }
            | ToAgent::Ack { stream, .. }
            | ToAgent::Resend { stream, .. }
                if *stream != self.backlog.stream || self.renewal.is_some() => {}
            ToAgent::Challenge { aggregator, nonce, enrol, version, .. } => {
                match wrong_version(aggregator, *version) {
                    Some(reason) => self.refused(&reason, now.mono),
                    None => self.challenged(aggregator, nonce, *enrol, now.mono),
                }
            }
            ToAgent::Welcome { aggregator, stored, chain, process, window, .. } => {
                self.answered(now.mono);
                let (aggregator, chain, process) = (aggregator.clone(), *chain, *process);
                self.allowed(*window);
                self.welcomed(Welcome { aggregator, stored: *stored, chain, process }, now);
            }
            ToAgent::Ack { through, window, .. } => {
                self.allowed(*window);
                self.acknowledged_through(*through, now);
            }
            ToAgent::Resend { from, .. } => self.asked_again(*from, now.mono),
            ToAgent::Echo { bytes } => {
                self.flow.echoed(*bytes, now.mono);
                if self.flow.is_slow() {
                    self.pace.is_slow();
                }
            }
            ToAgent::Refused { reason } => self.refused(reason, now.mono),
            ToAgent::Unknown if self.is_up() => self.greet_again(now.mono),
            ToAgent::Unknown => {}
        }
        self.notice()
    }

    /// The frame to send now, if there is one.
    pub(super) fn frame(&mut self, now: MonoTime) -> Option<Vec<u8>> {
        if let Some(proof) = self.proof.take() {
            return Some(proof);
        }
        match self.link {
            Link::Greeting { again, pause } if now >= again && self.renewal.is_none() => {
                self.link = Link::Greeting { again: now + pause, pause: self.longer(pause) };
                self.asked = (self.asked.0.saturating_add(1), now);
                Some(codec::encode(&ToAggregator::Hello(self.hello())))
            }
            Link::Up { next, heard } => self.durable(next, heard, now),
            _ => None,
        }
    }

    /// What is under way counts as not sent.
    fn take_back(&mut self) {
        self.under_way.lost(0);
        (self.rest, self.proof) = (None, None);
        self.pace.interrupted();
    }

    /// The aggregator answered a greeting. Which one of several is not known.
    fn answered(&mut self, now: MonoTime) {
        if let (1, at) = std::mem::take(&mut self.asked) {
            self.flow.round_trip(now - at, now);
        }
    }

    /// When the link has something to do without anything else happening.
    pub(super) fn link_deadline(&self) -> Option<MonoTime> {
        match self.link {
            Link::Greeting { again, .. } => self.renewal.is_none().then_some(again),
            _ => self.patience_ends().into_iter().chain(self.flow.remind_at().filter(|_| self.is_up())).min(),
        }
    }

    /// Greets again when nothing was acknowledged for too long.
    pub(super) fn lose_patience(&mut self, now: MonoTime) {
        if self.patience_ends().is_some_and(|limit| now >= limit) {
            self.greet_again(now);
        }
    }

    fn patience_ends(&self) -> Option<MonoTime> {
        match self.link {
            // What is on a slow link is not lost while it arrives bit by bit.
            Link::Up { next, heard } if next > self.backlog.oldest() => {
                Some(heard.max(self.flow.progress()) + self.config.patience)
            }
            _ => None,
        }
    }

    /// Says hello: at once, unless that led to nothing several times.
    pub(super) fn greet_again(&mut self, now: MonoTime) {
        let first = self.config.first_pause;
        if let Link::Up { heard, .. } = self.link
            && now - heard > self.config.longest_pause
        {
            // It held for long.
            self.greetings = 0;
        }
        let idle = self.greetings.saturating_sub(PROMPT_GREETINGS);
        let wait = (0..idle.min(16)).fold(Span::ZERO, |wait, _| self.longer(wait.max(first)));
        self.greetings = self.greetings.saturating_add(1);
        self.take_back();
        self.link = Link::Greeting { again: now + wait, pause: first.max(wait) };
    }

    fn longer(&self, pause: Span) -> Span {
        (pause + pause).min(self.config.longest_pause.max(self.config.refused_pause))
    }

    fn hello(&self) -> Hello {
        let (_, before) = self.backlog.acknowledged();
        Hello {
            protocol: STREAM_VERSIONS.oldest(),
            host: self.host.clone(),
            stream: self.backlog.stream,
            previous: self.backlog.previous,
            first: self.backlog.first,
            oldest: self.backlog.oldest(),
            before,
            events_before_oldest: self.stored,
            events_before_first: self.backlog.events_before_first,
            batch_bytes: u32::try_from(self.config.batch_bytes).unwrap_or(u32::MAX),
            process: self.process,
            extension: HelloExtension::of(&STREAM_VERSIONS),
        }
    }

    /// The aggregator asks for the proof that this host is who it says it is.
    fn challenged(&mut self, aggregator: &Slug, nonce: &Nonce, enrol: bool, now: MonoTime) {
        let Link::Greeting { pause, .. } = self.link else { return };
        self.answered(now);
        // What the proof leads to takes another round trip.
        self.link = Link::Greeting { again: now + pause, pause };
        let code = self.secret.prove(nonce, &self.hello(), aggregator);
        let secret = enrol.then(|| self.secret.clone());
        self.proof = Some(codec::encode(&ToAggregator::Proof(Proof {
            host: self.host.id,
            nonce: *nonce,
            code,
            secret,
        })));
        if enrol {
            self.notices.push_back(Notice::Enrolling { aggregator: aggregator.clone() });
        }
    }

    fn allowed(&mut self, window: u32) {
        self.window = window.clamp(1, self.config.window.max(1));
    }

    fn refused(&mut self, reason: &str, now: MonoTime) {
        let pause = match self.link {
            Link::Greeting { pause, .. } => pause.max(self.config.refused_pause),
            _ => self.config.refused_pause,
        };
        self.link = Link::Greeting { again: now + pause, pause: self.longer(pause) };
        self.notices.push_back(Notice::Refused(reason.to_owned()));
    }

    fn asked_again(&mut self, from: u64, now: MonoTime) {
        let Link::Up { next, heard } = self.link else { return };
        if from < self.backlog.oldest() {
            // It lacks what is no longer here: the hello tells it so, and it records the gap.
            self.greet_again(now);
        } else {
            self.link = Link::Up { next: next.min(from), heard };
            self.under_way.lost(from);
            self.rest.take_if(|rest| rest.number() >= from);
        }
    }

    fn acknowledged_through(&mut self, through: u64, now: Stamp) {
        let Link::Up { next, .. } = self.link else { return };
        if through > self.backlog.sent() {
            // Nobody can have stored what was not sent: the greeting finds out what there is.
            self.greet_again(now.mono);
        } else if through >= self.backlog.oldest() {
            self.greetings = 0;
            self.link = Link::Up { next: next.max(through + 1), heard: now.mono };
            self.acknowledged(through, None, now);
            self.pass_hole(now);
        }
    }

    /// The aggregator has batches up to a number. Ours of that number must be the same.
    fn welcomed(&mut self, mut welcome: Welcome, now: Stamp) {
        welcome.stored = welcome.stored.max(self.backlog.first - 1);
        let (acknowledged, _) = self.backlog.acknowledged();
        match self.link {
            Link::Greeting { .. } => {}
            // The answer to a second hello that was on its way.
            Link::Up { .. } if welcome.stored > acknowledged => {
                return match self.backlog.chain(welcome.stored) {
                    ours if ours == welcome.chain => self.acknowledged_through(welcome.stored, now),
                    _ => self.greet_again(now.mono),
                };
            }
            _ => return,
        }
        self.resolve_earlier(welcome.stored, welcome.process);
        if welcome.stored > self.backlog.newest() {
            return self.leave(&welcome, now);
        }
        if welcome.stored < acknowledged {
            return match self.has_sent(&welcome) {
                true => self.taken_in(welcome, true, now),
                false => self.leave(&welcome, now),
            };
        }
        match self.known(welcome.stored) {
            Some((chain, skimmed)) => self.judge(welcome, Some(chain), skimmed, now),
            None => {
                let skim = self.skim_to(welcome.stored);
                self.link = Link::Comparing { skim, then: Then::Compare(welcome) };
            }
        }
    }

    /// The file was read up to `through`; nothing is said of it when that batch was not in it.
    pub(super) fn compared(&mut self, through: u64, skimmed: Option<Skimmed>, then: Then, now: Stamp) {
        match then {
            Then::Compare(welcome) => {
                let chain = match skimmed {
                    Some((_, chain)) if welcome.stored == through => Some(chain),
                    Some(_) => self.backlog.chain(welcome.stored),
                    None => None,
                };
                self.judge(welcome, chain, skimmed, now);
            }
            Then::Leave => {
                if skimmed.is_some() {
                    self.acknowledged(through, skimmed, now);
                }
                self.renew_stream(now.mono);
            }
        }
    }

    /// Goes on when the aggregator's last batch is ours, of which the chain is `ours`.
    fn judge(&mut self, welcome: Welcome, ours: Option<Chain>, skimmed: Option<Skimmed>, now: Stamp) {
        let (acknowledged, _) = self.backlog.acknowledged();
        let nothing_to_compare =
            welcome.stored < self.backlog.first || welcome.stored == acknowledged && welcome.chain.is_none();
        if nothing_to_compare || ours.is_some() && ours == welcome.chain {
            if welcome.stored > acknowledged {
                self.acknowledged(welcome.stored, skimmed, now);
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
        welcome.chain.is_none() || welcome.process == Some(self.process) || self.reached_before.iter().any(by)
    }

    fn taken_in(&mut self, welcome: Welcome, lacks: bool, now: Stamp) {
        self.met = true;
        self.link = Link::Up { next: self.backlog.oldest(), heard: now.mono };
        let Welcome { aggregator, stored, .. } = welcome;
        self.notices.push_back(Notice::Welcomed { aggregator, stored, lacks });
        self.pass_hole(now);
    }

    /// The aggregator's stream is not ours any more.
    ///
    /// When its last batch came from a process that wrote to this spool, all is stored that the spool holds of that
    /// process ([`Reached`]): either the spool lost its end, or is a copy from which that process went on. What
    /// came into the spool later was never stored. When that batch came from another process, the spool is a copy of
    /// unknown age, and everything that is held is sent: rather twice, in two streams, than not at all.
    fn leave(&mut self, welcome: &Welcome, now: Stamp) {
        let (stored, newest) = (welcome.stored, self.backlog.newest());
        self.notices.push_back(Notice::StreamRenewed { stored, newest });
        let reached = self.reached_before.iter().find(|reached| Some(reached.process) == welcome.process);
        // An aggregator that has less than that, and something else, contradicts itself.
        let common =
            reached.filter(|reached| stored > reached.number).map_or(0, |reached| reached.number.min(newest));
        if common < self.backlog.oldest() {
            return self.renew_stream(now.mono);
        }
        match self.known(common) {
            Some((_, skimmed)) => {
                self.acknowledged(common, skimmed, now);
                self.renew_stream(now.mono);
            }
            None => self.link = Link::Comparing { skim: self.skim_to(common), then: Then::Leave },
        }
    }

    fn renew_stream(&mut self, now: MonoTime) {
        self.renewal = Some(StreamId::random());
        self.greet_again(now);
    }
}
