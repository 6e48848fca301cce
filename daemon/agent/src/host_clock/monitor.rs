//! Monitor of the host's clocks: detects steps, slews, sleeps and other disturbances.

use peernet_clock::{ClockWatch, Disturbance, MonoTime, SharedClock, Span};
use peernet_stream::IncidentKind;

use super::{Clocksource, Vmclock};
use crate::incidents::{IncidentSubject, Incidents, format_step_size};

/// Shortest time between two incidents about a slew. Every check finds a slew if the clock has a wrong rate.
const SLEW_REPORT_INTERVAL: Span = Span::from_seconds(60);

/// Consequence of a disturbance of the wall clock.
const WALL_CONSEQUENCE: &str = "delays are not affected, because they are measured with the free-running clock; claims about the wall clock are void";
/// Consequence of a disturbance of the free-running clock.
const RAW_CONSEQUENCE: &str = "delays of messages in flight at that time have no value";

/// Monitor of a host's clocks, which reports every disturbance as an incident.
#[derive(Debug)]
pub(super) struct HostClockMonitor {
    clock: SharedClock,
    watch: ClockWatch,
    max_drift_ppm: f64,
    /// Epoch of the wall clock at the last check.
    wall_epoch: u32,
    last_slew_report: Option<MonoTime>,
    clocksource: Clocksource,
    /// Name of the clocksource at the last check.
    clocksource_name: String,
    vmclock: Vmclock,
}

impl HostClockMonitor {
    pub(super) fn new(
        max_drift_ppm: f64,
        clock: SharedClock,
        clocksource: Clocksource,
        vmclock: Vmclock,
    ) -> Self {
        let (watch, wall_epoch) = (ClockWatch::new(max_drift_ppm), clock.wall_epoch());
        let clocksource_name = clocksource.name();
        Self {
            clock,
            watch,
            max_drift_ppm,
            wall_epoch,
            last_slew_report: None,
            clocksource,
            clocksource_name,
            vmclock,
        }
    }

    /// Returns the name of the clocksource from which the kernel read the time at the last check.
    pub(super) fn clocksource(&self) -> &str {
        &self.clocksource_name
    }

    /// Checks all clocks once. If the wall clock was disturbed, [`Clock::wall_epoch`](peernet_clock::Clock::wall_epoch)
    /// has a new value afterwards. If the free-running clock was disturbed,
    /// [`Clock::epoch`](peernet_clock::Clock::epoch) has a new value afterwards.
    pub(super) fn check(&mut self, incidents: &Incidents) {
        let readings = self.clock.readings();
        let disturbances = self.watch.compare(readings);
        // The clock itself begins a new epoch after a step. After a slew or a sleep the new epoch begins here, because
        // the earlier bounds on the error of the wall clock no longer hold.
        if !disturbances.is_empty() && self.clock.wall_epoch() == self.wall_epoch {
            self.clock.begin_wall_epoch();
        }
        let wall_epoch = self.clock.wall_epoch();
        // The clock may have detected a step that is too small for the watch.
        let small_step = (wall_epoch != self.wall_epoch && disturbances.is_empty())
            .then(|| self.clock.last_step())
            .flatten();
        self.wall_epoch = wall_epoch;
        let all_disturbances = disturbances.into_iter().chain(small_step.map(Disturbance::Step));
        let mut texts: Vec<String> =
            all_disturbances.filter_map(|disturbance| self.describe(disturbance, readings.mono)).collect();
        // The clocksource is compared after the clocks, because a change of the clocksource may have caused the
        // disturbance that the clocks show.
        texts.extend(self.check_clocksource());
        texts.extend(self.check_vmclock());
        for text in texts {
            incidents.report(IncidentKind::ClockStep, IncidentSubject::default(), text);
        }
    }

    /// Begins new epochs after a change of the clocksource.
    // The new clocksource has another rate, and the kernel does not report how exactly it continued the time.
    fn check_clocksource(&mut self) -> Option<String> {
        let name = self.clocksource.name();
        if name == self.clocksource_name {
            return None;
        }
        self.begin_epochs();
        let old_name = std::mem::replace(&mut self.clocksource_name, name);
        let [old_name, new_name] = [&old_name, &self.clocksource_name]
            .map(|name| if name.is_empty() { "an unknown one" } else { name.as_str() });
        Some(format!("this host's clocksource changed from {old_name} to {new_name}; {RAW_CONSEQUENCE}"))
    }

    /// Begins new epochs after a disruption that the hypervisor reports. No clock of the virtual machine shows such a
    /// disruption.
    fn check_vmclock(&mut self) -> Option<String> {
        let device = self.vmclock.find_disrupted_device()?.display().to_string();
        self.begin_epochs();
        Some(format!(
            "{device} reports that the hypervisor disrupted this host's clocks, as when a virtual machine is paused or moved; \
             {RAW_CONSEQUENCE}"
        ))
    }

    /// Begins a new epoch of both clocks, because older stamps cannot be compared with new ones.
    fn begin_epochs(&mut self) {
        self.clock.begin_epoch();
        self.clock.begin_wall_epoch();
        self.wall_epoch = self.clock.wall_epoch();
    }

    /// Describes a disturbance; `None` for a slew soon after the last described slew.
    fn describe(&mut self, disturbance: Disturbance, now: MonoTime) -> Option<String> {
        match disturbance {
            Disturbance::Step(by) => {
                let direction = if by.is_negative() { "back" } else { "forward" };
                Some(format!(
                    "this host's wall clock was set {direction} by {}; {WALL_CONSEQUENCE}",
                    format_step_size(by)
                ))
            }
            Disturbance::Slew(ppm) => {
                let is_due =
                    self.last_slew_report.is_none_or(|reported_at| now - reported_at >= SLEW_REPORT_INTERVAL);
                is_due.then(|| {
                    self.last_slew_report = Some(now);
                    let direction = if ppm < 0.0 { "slower" } else { "faster" };
                    format!(
                        "this host's wall clock runs {:.0} ppm {direction} than usual against its free-running clock, more than \
                         clock.max_drift_ppm = {}; {WALL_CONSEQUENCE}",
                        ppm.abs(),
                        self.max_drift_ppm
                    )
                })
            }
            Disturbance::Suspend(duration) => {
                Some(format!("this host slept for {:.3} s; {RAW_CONSEQUENCE}", duration.seconds()))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use std::fs::File;
    use std::sync::Arc;

    use peernet_clock::{ClockFaults, ClockIdentity, FaultyClock, ManualClock, WallTime};
    use peernet_stream::Event;
    use tokio::sync::mpsc;

    use super::super::vmclock::tests::{create_device, disrupt};
    use super::*;
    use crate::event_queue::{EventQueue, EventTap};

    /// A monitor with a clock that drifts and that the test moves.
    struct ClockTestbed {
        manual: Arc<ManualClock>,
        clock: SharedClock,
        monitor: HostClockMonitor,
        incidents: Incidents,
        events: mpsc::Receiver<Event>,
        /// Root of the monitor's sysfs.
        sys: tempfile::TempDir,
        /// The monitor's vmclock device.
        vmclock: File,
    }

    impl ClockTestbed {
        fn new(drift_ppm: f64) -> Self {
            let since = WallTime::from_unix_nanos(1_700_000_000_000_000_000);
            let identity = ClockIdentity::new("boot", "clock");
            let manual = Arc::new(ManualClock::new(since, identity.clone()));
            let faults = ClockFaults { offset: Span::ZERO, drift_ppm, steps: Vec::new(), since };
            let inner = Arc::clone(&manual) as SharedClock;
            let clock: SharedClock = Arc::new(FaultyClock::new(inner, identity, faults));
            let (sender, events) = mpsc::channel(100);
            let event_queue = EventQueue::discarding().with_tap(Some(EventTap::new(sender)));
            let incidents = Incidents::new(Arc::clone(&clock), event_queue);
            let sys = tempfile::tempdir().expect("a folder");
            let clocksource = Clocksource::from_sysfs(sys.path());
            let marker = 7;
            let vmclock = create_device(sys.path(), marker);
            let mut monitor =
                HostClockMonitor::new(50.0, Arc::clone(&clock), clocksource, Vmclock::open_all(sys.path()));
            monitor.check(&incidents);
            Self { manual, clock, monitor, incidents, events, sys, vmclock }
        }

        /// Checks the clocks ten times a second for `seconds` seconds.
        fn check_for(&mut self, seconds: usize) {
            for _ in 0..seconds * 10 {
                self.manual.advance(Span::from_millis(100));
                self.monitor.check(&self.incidents);
            }
        }

        fn take_reported_texts(&mut self) -> Vec<String> {
            let mut texts = Vec::new();
            while let Ok(Event::Incident(incident)) = self.events.try_recv() {
                assert_eq!(incident.kind, IncidentKind::ClockStep);
                texts.push(incident.text);
            }
            texts
        }
    }

    #[test]
    fn step_is_reported_with_direction_and_size() {
        let mut testbed = ClockTestbed::new(40.0);
        testbed.check_for(1);
        assert!(testbed.take_reported_texts().is_empty());
        for (by, words) in [
            (Span::from_seconds(3), "forward by 3.000 s"),
            (Span::from_millis(-250), "back by 0.250 s"),
            (Span::from_micros(30), "forward by 0.030 ms"),
        ] {
            let old_epoch = testbed.clock.wall_epoch();
            testbed.manual.step_wall(by);
            testbed.check_for(1);
            let reported = testbed.take_reported_texts();
            assert!(matches!(&reported[..], [text] if text.contains(words)), "{words}: {reported:?}");
            assert_eq!(testbed.clock.wall_epoch(), old_epoch + 1, "each step begins one epoch");
        }
    }

    #[test]
    fn drift_within_limit_is_not_reported() {
        let mut testbed = ClockTestbed::new(40.0);
        testbed.check_for(60);
        assert_eq!((testbed.take_reported_texts().len(), testbed.clock.wall_epoch()), (0, 0));
    }

    #[test]
    fn slew_begins_epochs_with_one_report_per_minute() {
        let mut testbed = ClockTestbed::new(0.0);
        let slew_for = |testbed: &mut ClockTestbed, seconds: i64| {
            for _ in 0..seconds * 10 {
                testbed.manual.slew_wall(Span::from_micros(-25));
                testbed.manual.advance(Span::from_millis(100));
                testbed.monitor.check(&testbed.incidents);
            }
        };
        slew_for(&mut testbed, 50);
        let reported = testbed.take_reported_texts();
        assert!(matches!(&reported[..], [text] if text.contains("ppm slower than usual")), "{reported:?}");
        assert!(testbed.clock.wall_epoch() > 5, "{}", testbed.clock.wall_epoch());
        slew_for(&mut testbed, 60);
        assert_eq!(testbed.take_reported_texts().len(), 1);
        assert_eq!(testbed.clock.epoch(), 0, "the free-running clock was not interrupted");
    }

    #[test]
    fn sleep_and_another_clocksource_interrupt_free_running_clock() {
        let mut testbed = ClockTestbed::new(0.0);
        testbed.manual.sleep(Span::from_seconds(7));
        testbed.check_for(1);
        let reported = testbed.take_reported_texts();
        assert!(matches!(&reported[..], [text] if text.contains("slept for 7.000 s")), "{reported:?}");
        assert_eq!((testbed.clock.epoch(), testbed.clock.wall_epoch()), (1, 1));

        let file = testbed.sys.path().join("devices/system/clocksource/clocksource0/current_clocksource");
        std::fs::create_dir_all(file.parent().expect("the file has a folder")).expect("made");
        std::fs::write(&file, "hpet\n").expect("written");
        testbed.check_for(1);
        let reported = testbed.take_reported_texts();
        assert!(
            matches!(&reported[..], [text] if text.contains("changed from an unknown one to hpet")),
            "{reported:?}"
        );
        assert_eq!((testbed.clock.epoch(), testbed.clock.wall_epoch()), (2, 2));
    }

    #[test]
    fn hypervisor_disruption_begins_epoch_of_both_clocks() {
        let mut testbed = ClockTestbed::new(0.0);
        testbed.check_for(1);
        assert!(testbed.take_reported_texts().is_empty());
        let (sequence, new_marker) = (0, 8);
        disrupt(&testbed.vmclock, sequence, new_marker);
        testbed.check_for(1);
        let reported = testbed.take_reported_texts();
        assert!(
            matches!(&reported[..], [text] if text.contains("reports that the hypervisor disrupted") && text.contains("vmclock0")),
            "{reported:?}"
        );
        assert_eq!((testbed.clock.epoch(), testbed.clock.wall_epoch()), (1, 1));
    }
}
