//! Looks whether the wall clock still goes as it should.

use peernet_clock::{Disturbance, MonoTime, SharedClock, Span, Watch};
use peernet_stream::IncidentKind;

use crate::incidents::{Concerning, Incidents, far_in_words};

/// A clock that runs off goes on doing so: it is told at most so often.
const SLEW_TOLD_EVERY: Span = Span::from_seconds(60);

/// Looks at a host's clocks and tells what is odd.
#[derive(Debug)]
pub(super) struct Watchman {
    clock: SharedClock,
    watch: Watch,
    max_drift_ppm: f64,
    epoch: u32,
    slew_told: Option<MonoTime>,
}

impl Watchman {
    pub(super) fn new(max_drift_ppm: f64, clock: SharedClock) -> Self {
        let (watch, epoch) = (Watch::new(max_drift_ppm), clock.wall_epoch());
        Self { clock, watch, max_drift_ppm, epoch, slew_told: None }
    }

    /// Looks once. After it [`Clock::wall_epoch`](peernet_clock::Clock::wall_epoch) is a new one if the clock was disturbed.
    pub(super) fn look(&mut self, incidents: &Incidents) {
        let readings = self.clock.readings();
        let disturbances = self.watch.look(readings);
        // A step the clock notices by itself; a slew or a suspend it cannot.
        if !disturbances.is_empty() && self.clock.wall_epoch() == self.epoch {
            self.clock.begin_wall_epoch();
        }
        let epoch = self.clock.wall_epoch();
        // What is too little to be seen from here the clock may have seen itself.
        let unseen =
            (epoch != self.epoch && disturbances.is_empty()).then(|| self.clock.last_step()).flatten();
        self.epoch = epoch;
        let all = disturbances.into_iter().chain(unseen.map(Disturbance::Step));
        let texts: Vec<String> = all.filter_map(|odd| self.in_words(odd, readings.mono)).collect();
        for text in texts {
            let text = format!("{text}; delays of that moment are left out");
            incidents.report(IncidentKind::ClockStep, Concerning::default(), text);
        }
    }

    /// `None` when it was told often enough.
    fn in_words(&mut self, disturbance: Disturbance, now: MonoTime) -> Option<String> {
        match disturbance {
            Disturbance::Step(by) => {
                let direction = if by.is_negative() { "back" } else { "forward" };
                Some(format!("this host's wall clock was set {direction} by {}", far_in_words(by)))
            }
            Disturbance::Slew(ppm) => {
                let due = self.slew_told.is_none_or(|told| now - told >= SLEW_TOLD_EVERY);
                due.then(|| {
                    self.slew_told = Some(now);
                    let direction = if ppm < 0.0 { "slower" } else { "faster" };
                    format!(
                        "this host's wall clock runs {:.0} ppm {direction} than it should, with clock.max_drift_ppm = {}",
                        ppm.abs(),
                        self.max_drift_ppm
                    )
                })
            }
            Disturbance::Suspend(slept) => Some(format!("this host slept for {:.3} s", slept.seconds())),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use peernet_clock::{ClockIdentity, ManualClock, RehearsalDescription, RehearsedClock, WallTime};
    use peernet_stream::Event;
    use tokio::sync::mpsc;

    use super::*;
    use crate::feed::{Feed, Tap};

    /// A clock that moves when told to, with a drift, under watch.
    struct Scene {
        manual: Arc<ManualClock>,
        clock: SharedClock,
        watchman: Watchman,
        incidents: Incidents,
        told: mpsc::Receiver<Event>,
    }

    impl Scene {
        fn new(drift_ppm: f64) -> Self {
            let since = WallTime::from_unix_nanos(1_700_000_000_000_000_000);
            let identity = ClockIdentity::new("boot", "clock");
            let manual = Arc::new(ManualClock::new(since, identity.clone()));
            let drifts = RehearsalDescription { offset: Span::ZERO, drift_ppm, steps: Vec::new(), since };
            let inner = Arc::clone(&manual) as SharedClock;
            let clock: SharedClock = Arc::new(RehearsedClock::new(inner, identity, drifts));
            let (listener, told) = mpsc::channel(100);
            let feed = Feed::nowhere().tapped(Some(Tap::new(listener)));
            let incidents = Incidents::new(Arc::clone(&clock), feed);
            let mut watchman = Watchman::new(50.0, Arc::clone(&clock));
            watchman.look(&incidents);
            Self { manual, clock, watchman, incidents, told }
        }

        /// Looks ten times a second.
        fn look_for(&mut self, seconds: usize) {
            for _ in 0..seconds * 10 {
                self.manual.advance(Span::from_millis(100));
                self.watchman.look(&self.incidents);
            }
        }

        fn told(&mut self) -> Vec<String> {
            let mut texts = Vec::new();
            while let Ok(Event::Incident(incident)) = self.told.try_recv() {
                assert_eq!(incident.kind, IncidentKind::ClockStep);
                texts.push(incident.text);
            }
            texts
        }
    }

    #[test]
    fn a_step_is_an_incident_in_words() {
        let mut scene = Scene::new(40.0);
        scene.look_for(1);
        assert!(scene.told().is_empty());
        for (by, words) in [
            (Span::from_seconds(3), "forward by 3.000 s"),
            (Span::from_millis(-250), "back by 0.250 s"),
            (Span::from_micros(30), "forward by 0.030 ms"),
        ] {
            let before = scene.clock.wall_epoch();
            scene.manual.step_wall(by);
            scene.look_for(1);
            let told = scene.told();
            assert!(matches!(&told[..], [text] if text.contains(words)), "{words}: {told:?}");
            assert_eq!(scene.clock.wall_epoch(), before + 1, "one step, one epoch");
        }
    }

    #[test]
    fn a_drift_within_the_limit_is_nothing_to_tell() {
        let mut scene = Scene::new(40.0);
        scene.look_for(60);
        assert_eq!((scene.told().len(), scene.clock.wall_epoch()), (0, 0));
    }

    #[test]
    fn a_clock_that_runs_off_begins_epoch_after_epoch_and_is_told_once_a_minute() {
        let mut scene = Scene::new(-250.0);
        scene.look_for(50);
        let told = scene.told();
        assert!(matches!(&told[..], [text] if text.contains("ppm slower than it should")), "{told:?}");
        assert!(scene.clock.wall_epoch() > 5, "{}", scene.clock.wall_epoch());
        scene.look_for(60);
        assert_eq!(scene.told().len(), 1);
    }
}
