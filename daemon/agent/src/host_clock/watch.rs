//! Looks whether the clocks still go as they should.

use peernet_clock::{Disturbance, MonoTime, SharedClock, Span, Watch};
use peernet_stream::IncidentKind;

use super::{Clocksource, Vmclock};
use crate::incidents::{Concerning, Incidents, far_in_words};

/// A clock that runs off goes on doing so: it is told at most so often.
const SLEW_TOLD_EVERY: Span = Span::from_seconds(60);

/// What a disturbance of the wall clock means for delays.
const OF_WALL: &str =
    "delays are measured by the free-running clock and do not change; claims about the wall clock are void";
/// What a disturbance of the free-running clock means for them.
const OF_RAW: &str = "delays of that moment are left out";

/// Looks at a host's clocks and tells what is odd.
#[derive(Debug)]
pub(super) struct Watchman {
    clock: SharedClock,
    watch: Watch,
    max_drift_ppm: f64,
    wall_epoch: u32,
    slew_told: Option<MonoTime>,
    clocksource: Clocksource,
    /// Its name at the last look.
    clocksource_name: String,
    vmclock: Vmclock,
}

impl Watchman {
    pub(super) fn new(
        max_drift_ppm: f64,
        clock: SharedClock,
        clocksource: Clocksource,
        vmclock: Vmclock,
    ) -> Self {
        let (watch, wall_epoch) = (Watch::new(max_drift_ppm), clock.wall_epoch());
        let clocksource_name = clocksource.name();
        Self {
            clock,
            watch,
            max_drift_ppm,
            wall_epoch,
            slew_told: None,
            clocksource,
            clocksource_name,
            vmclock,
        }
    }

    /// What the kernel read the time from at the last look.
    pub(super) fn clocksource(&self) -> &str {
        &self.clocksource_name
    }

    /// Looks once. After it [`Clock::wall_epoch`](peernet_clock::Clock::wall_epoch) is a new one if the wall clock was disturbed, and
    /// [`Clock::epoch`](peernet_clock::Clock::epoch) if the free-running one was.
    pub(super) fn look(&mut self, incidents: &Incidents) {
        let readings = self.clock.readings();
        let disturbances = self.watch.look(readings);
        // A step the clock notices by itself; a slew it cannot. After a sleep no claim holds that was made before it.
        if !disturbances.is_empty() && self.clock.wall_epoch() == self.wall_epoch {
            self.clock.begin_wall_epoch();
        }
        let wall_epoch = self.clock.wall_epoch();
        // What is too little to be seen from here the clock may have seen itself.
        let unseen = (wall_epoch != self.wall_epoch && disturbances.is_empty())
            .then(|| self.clock.last_step())
            .flatten();
        self.wall_epoch = wall_epoch;
        let all = disturbances.into_iter().chain(unseen.map(Disturbance::Step));
        let mut texts: Vec<String> = all.filter_map(|odd| self.in_words(odd, readings.mono)).collect();
        texts.extend(self.look_at_clocksource());
        texts.extend(self.look_at_vmclock());
        for text in texts {
            incidents.report(IncidentKind::ClockStep, Concerning::default(), text);
        }
    }

    /// Another clocksource has another rate, and nobody knows how well the kernel joined the two.
    fn look_at_clocksource(&mut self) -> Option<String> {
        let name = self.clocksource.name();
        if name == self.clocksource_name {
            return None;
        }
        self.begin_epochs();
        let before = std::mem::replace(&mut self.clocksource_name, name);
        Some(format!("this host's clocksource changed from {before} to {}; {OF_RAW}", self.clocksource_name))
    }

    /// The hypervisor says that the counter went on differently, as no clock of the machine itself can tell.
    fn look_at_vmclock(&mut self) -> Option<String> {
        let device = self.vmclock.disrupted()?.display().to_string();
        self.begin_epochs();
        Some(format!(
            "the hypervisor disrupted this host's clocks, by the word of {device}, as when a virtual machine is paused or moved; \
             {OF_RAW}"
        ))
    }

    /// What was stamped before says nothing about what is stamped from now on, by either clock.
    fn begin_epochs(&mut self) {
        self.clock.begin_epoch();
        self.clock.begin_wall_epoch();
        self.wall_epoch = self.clock.wall_epoch();
    }

    /// `None` when it was told often enough.
    fn in_words(&mut self, disturbance: Disturbance, now: MonoTime) -> Option<String> {
        match disturbance {
            Disturbance::Step(by) => {
                let direction = if by.is_negative() { "back" } else { "forward" };
                Some(format!("this host's wall clock was set {direction} by {}; {OF_WALL}", far_in_words(by)))
            }
            Disturbance::Slew(ppm) => {
                let due = self.slew_told.is_none_or(|told| now - told >= SLEW_TOLD_EVERY);
                due.then(|| {
                    self.slew_told = Some(now);
                    let direction = if ppm < 0.0 { "slower" } else { "faster" };
                    format!(
                        "this host's wall clock runs {:.0} ppm {direction} than it should, with clock.max_drift_ppm = {}; \
                         {OF_WALL}",
                        ppm.abs(),
                        self.max_drift_ppm
                    )
                })
            }
            Disturbance::Suspend(slept) => {
                Some(format!("this host slept for {:.3} s; {OF_RAW}", slept.seconds()))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use std::fs::File;
    use std::sync::Arc;

    use peernet_clock::{ClockIdentity, ManualClock, RehearsalDescription, RehearsedClock, WallTime};
    use peernet_stream::Event;
    use tokio::sync::mpsc;

    use super::super::vmclock::tests::{disrupt, make};
    use super::*;
    use crate::feed::{Feed, Tap};

    /// A clock that moves when told to, with a drift, under watch.
    struct Scene {
        manual: Arc<ManualClock>,
        clock: SharedClock,
        watchman: Watchman,
        incidents: Incidents,
        told: mpsc::Receiver<Event>,
        /// Its sysfs.
        sys: tempfile::TempDir,
        /// Its vmclock device.
        vmclock: File,
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
            let sys = tempfile::tempdir().expect("a folder");
            let clocksource = Clocksource::below(sys.path());
            let vmclock = make(sys.path(), 7);
            let mut watchman =
                Watchman::new(50.0, Arc::clone(&clock), clocksource, Vmclock::below(sys.path()));
            watchman.look(&incidents);
            Self { manual, clock, watchman, incidents, told, sys, vmclock }
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
        let mut scene = Scene::new(0.0);
        let slewed = |scene: &mut Scene, seconds: i64| {
            for _ in 0..seconds * 10 {
                scene.manual.slew_wall(Span::from_micros(-25));
                scene.manual.advance(Span::from_millis(100));
                scene.watchman.look(&scene.incidents);
            }
        };
        slewed(&mut scene, 50);
        let told = scene.told();
        assert!(matches!(&told[..], [text] if text.contains("ppm slower than it should")), "{told:?}");
        assert!(scene.clock.wall_epoch() > 5, "{}", scene.clock.wall_epoch());
        slewed(&mut scene, 60);
        assert_eq!(scene.told().len(), 1);
        assert_eq!(scene.clock.epoch(), 0, "the free-running clock went on");
    }

    #[test]
    fn sleep_and_another_clocksource_interrupt_free_running_clock() {
        let mut scene = Scene::new(0.0);
        scene.manual.sleep(Span::from_seconds(7));
        scene.look_for(1);
        let told = scene.told();
        assert!(matches!(&told[..], [text] if text.contains("slept for 7.000 s")), "{told:?}");
        assert_eq!((scene.clock.epoch(), scene.clock.wall_epoch()), (1, 1));

        let file = scene.sys.path().join("devices/system/clocksource/clocksource0/current_clocksource");
        std::fs::create_dir_all(file.parent().expect("it has one")).expect("made");
        std::fs::write(&file, "hpet\n").expect("written");
        scene.look_for(1);
        let told = scene.told();
        assert!(matches!(&told[..], [text] if text.contains("changed from  to hpet")), "{told:?}");
        assert_eq!((scene.clock.epoch(), scene.clock.wall_epoch()), (2, 2));
    }

    #[test]
    fn disruption_by_hypervisor_begins_new_epoch_of_both_clocks() {
        let mut scene = Scene::new(0.0);
        scene.look_for(1);
        assert!(scene.told().is_empty());
        disrupt(&scene.vmclock, 0, 8);
        scene.look_for(1);
        let told = scene.told();
        assert!(
            matches!(&told[..], [text] if text.contains("the hypervisor disrupted") && text.contains("vmclock0")),
            "{told:?}"
        );
        assert_eq!((scene.clock.epoch(), scene.clock.wall_epoch()), (1, 1));
    }
}
