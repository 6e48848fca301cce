//! Checks the tables about time: `[clock]`, `[probes]`, `[clock_fault]`.

use std::net::UdpSocket;
use std::path::Path;
use std::{env, io};

use peernet_probes::Key;

use super::Report;
use crate::config::{
    ClaimSource, ClockConfig, ClockFaultConfig, ClockFaultStepConfig, ProbesConfig, ServeConfig,
};

/// Largest drift between two clocks that may be configured, in parts per million. A clock that drifts faster is
/// broken.
const MAX_DRIFT_PPM: f64 = 1000.0;
/// Largest `clock.window_s`: a day.
const MAX_WINDOW_S: f64 = 86_400.0;
/// Largest `clock.fresh_s` and `clock.discipline_interval_s`: an hour.
const MAX_TIME_S: f64 = 3600.0;
/// Largest `probes.rate_hz` and `probes.idle_rate_hz`.
const MAX_RATE_HZ: f64 = 1000.0;
/// Maximum number of answered probes per second and address.
const MAX_PER_SOURCE_HZ: u64 = 10_000;
/// Largest padding of a probe in bytes. A probe with this padding fits into one Ethernet frame, with and without
/// authentication.
const MAX_PADDING_BYTES: u64 = 1300;
/// Largest offset or step of a clock fault, in milliseconds: about four months.
const MAX_FAULT_MS: f64 = 1e10;
/// Fastest change of the drift that may be configured, in parts per million per second. No oscillator changes so
/// fast.
const MAX_DRIFT_CHANGE_PPM_PER_S: f64 = 1_000.0;
/// Largest drift of a clock fault, in parts per million: 100 ms per second.
const MAX_FAULT_PPM: f64 = 100_000.0;
/// Latest time of a step of a clock fault, in seconds after the start of the agent: a year.
const MAX_FAULT_S: f64 = 366.0 * 86_400.0;
/// Maximum number of `clock_fault.steps`. The number is limited because the agent sends all steps to each peer.
const MAX_FAULT_STEPS: u64 = 1000;

impl Report {
    /// Adds a problem if the value is not in the range; NaN is outside every range.
    fn check_range(&mut self, key: &str, value: f64, min: f64, max: f64) {
        if !(min..=max).contains(&value) {
            self.add(key, format!("{value} is not between {min} and {max}"));
        }
    }

    fn check_positive(&mut self, key: &str, value: f64, max: f64) {
        if !(value > 0.0 && value <= max) {
            self.add(key, format!("{value} is out of range; the value must be above 0 and at most {max}"));
        }
    }
}

pub(super) fn check_clock(report: &mut Report, clock: &ClockConfig) {
    report.check_positive("clock.max_drift_ppm", clock.max_drift_ppm, MAX_DRIFT_PPM);
    let change = clock.max_drift_change_ppm_per_s;
    report.check_positive("clock.max_drift_change_ppm_per_s", change, MAX_DRIFT_CHANGE_PPM_PER_S);
    report.check_range("clock.window_s", clock.window_s, 10.0, MAX_WINDOW_S);
    report.check_range("clock.fresh_s", clock.fresh_s, 0.1, MAX_TIME_S);
    if clock.fresh_s > clock.window_s {
        let text = format!(
            "{} s is longer than clock.window_s = {}, the time for which exchanges are kept; choose a shorter time",
            clock.fresh_s, clock.window_s
        );
        report.add("clock.fresh_s", text);
    }
    report.check_range("clock.discipline_interval_s", clock.discipline_interval_s, 0.1, MAX_TIME_S);
    if clock.chronyc.is_empty() {
        report.add(
            "clock.chronyc",
            "is empty; remove the key to use \"chronyc\", or remove chrony from clock.discipline",
        );
    } else if clock.chronyc != ClockConfig::default().chronyc
        && clock.discipline.contains(&ClaimSource::Chrony)
        && !is_command(&clock.chronyc)
    {
        // A missing default command is not a problem: not every host has chrony.
        let text = format!(
            "this machine has no command {:?}; install chrony, or remove chrony from clock.discipline",
            clock.chronyc
        );
        report.add("clock.chronyc", text);
    }
    for (index, source) in clock.discipline.iter().enumerate() {
        if clock.discipline[..index].contains(source) {
            report.add(
                format!("clock.discipline[{index}]"),
                "the list contains this source twice; remove one of the two",
            );
        }
    }
}

/// Returns whether `name` is an existing path, or the name of a file in a folder of `PATH`.
fn is_command(name: &str) -> bool {
    if name.contains('/') {
        return Path::new(name).is_file();
    }
    env::var_os("PATH").is_some_and(|path| env::split_paths(&path).any(|folder| folder.join(name).is_file()))
}

pub(super) fn check_probes(report: &mut Report, probes: &ProbesConfig, serve: Option<&ServeConfig>) {
    report.check_positive("probes.rate_hz", probes.rate_hz, MAX_RATE_HZ);
    report.check_positive("probes.idle_rate_hz", probes.idle_rate_hz, MAX_RATE_HZ);
    if probes.idle_rate_hz > probes.rate_hz {
        let text = format!("{} is more than probes.rate_hz = {}", probes.idle_rate_hz, probes.rate_hz);
        report.add("probes.idle_rate_hz", text);
    }
    report.check_max("probes.padding_bytes", probes.padding_bytes.into(), MAX_PADDING_BYTES);
    if probes.max_per_source_hz == 0 {
        report.add(
            "probes.max_per_source_hz",
            "with 0 no probe is answered; if you want this, set reflect = false instead",
        );
    }
    report.check_max("probes.max_per_source_hz", probes.max_per_source_hz.into(), MAX_PER_SOURCE_HZ);
    if !probes.send && !probes.reflectors.is_empty() {
        report.add(
            "probes.reflectors",
            "probes.send = false, so no probes are sent to these reflectors; remove probes.send, or remove the reflectors",
        );
    }
    if let Some(path) = &probes.key_file {
        report.check_result("probes.key_file", Key::read(path));
    }
    if let (Some(port), true, Some(serve)) = (probes.port, probes.reflect, serve) {
        serve.listen.as_slice().iter().for_each(|address| check_port(report, &address.host(), port));
    }
}

/// Checks that this user may open the UDP port. As for `serve.listen`, a port in use is not a problem. An address of
/// another machine is reported by the check of `serve.listen`.
fn check_port(report: &mut Report, host: &str, port: u16) {
    if let Err(error) = UdpSocket::bind((host, port))
        && error.kind() == io::ErrorKind::PermissionDenied
    {
        let text = format!(
            "cannot receive on UDP port {port}: {error}; ports below 1024 need the capability CAP_NET_BIND_SERVICE, \
             which the systemd unit grants"
        );
        report.add("probes.port", text);
    }
}

pub(super) fn check_clock_fault(report: &mut Report, clock_fault: &ClockFaultConfig) {
    report.check_range("clock_fault.offset_ms", clock_fault.offset_ms, -MAX_FAULT_MS, MAX_FAULT_MS);
    report.check_range("clock_fault.drift_ppm", clock_fault.drift_ppm, -MAX_FAULT_PPM, MAX_FAULT_PPM);
    let mut previous: Option<&ClockFaultStepConfig> = None;
    report.check_max("clock_fault.steps", clock_fault.steps.len() as u64, MAX_FAULT_STEPS);
    for (index, step) in clock_fault.steps.iter().enumerate() {
        let prefix = format!("clock_fault.steps[{index}]");
        report.check_range(&format!("{prefix}.by_ms"), step.by_ms, -MAX_FAULT_MS, MAX_FAULT_MS);
        report.check_positive(&format!("{prefix}.at_s"), step.at_s, MAX_FAULT_S);
        // The wall clock and the free-running clock may be stepped at the same moment, as when a virtual machine was
        // paused.
        let is_in_order = |previous: &ClockFaultStepConfig| {
            previous.at_s < step.at_s || (previous.at_s == step.at_s && previous.clock != step.clock)
        };
        if let Some(previous) = previous.filter(|previous| !is_in_order(previous)) {
            let text = format!(
                "{} s is not after the previous step at {} s; sort the steps by time",
                step.at_s, previous.at_s
            );
            report.add(format!("{prefix}.at_s"), text);
        }
        previous = Some(step);
    }
}

#[cfg(test)]
mod tests {
    use super::super::Report;
    use super::*;

    fn problem_keys(check: impl FnOnce(&mut Report)) -> Vec<String> {
        let mut report = Report::default();
        check(&mut report);
        report.0.into_iter().map(|problem| problem.key).collect()
    }

    fn read<T: serde::de::DeserializeOwned>(table: &str) -> T {
        toml::from_str(table).unwrap_or_else(|error| panic!("{table}: {error}"))
    }

    fn problems_of_clock(table: &str) -> Vec<String> {
        problem_keys(|report| check_clock(report, &read(table)))
    }

    fn problems_of_probes(table: &str) -> Vec<String> {
        problem_keys(|report| check_probes(report, &read(table), Some(&ServeConfig::default())))
    }

    fn problems_of_clock_fault(table: &str) -> Vec<String> {
        problem_keys(|report| check_clock_fault(report, &read(table)))
    }

    #[test]
    fn default_settings_have_no_problems() {
        let nothing: [String; 0] = [];
        assert_eq!(
            (problems_of_clock(""), problems_of_probes(""), problems_of_clock_fault("")),
            (nothing.to_vec(), nothing.to_vec(), nothing.to_vec())
        );
    }

    #[test]
    fn impossible_limits_are_refused() {
        assert_eq!(problems_of_clock("max_drift_ppm = -50"), ["clock.max_drift_ppm"]);
        assert_eq!(problems_of_clock("max_drift_ppm = nan"), ["clock.max_drift_ppm"]);
        let change = "clock.max_drift_change_ppm_per_s";
        assert_eq!(problems_of_clock("max_drift_change_ppm_per_s = 0"), [change]);
        assert_eq!(problems_of_clock("max_drift_change_ppm_per_s = 1001"), [change]);
        assert_eq!(problems_of_clock("window_s = 20\nfresh_s = 30"), ["clock.fresh_s"]);
        assert_eq!(
            problems_of_clock("discipline_interval_s = 0\nchronyc = \"\""),
            ["clock.discipline_interval_s", "clock.chronyc"]
        );
        assert_eq!(
            problems_of_probes("rate_hz = 0\nidle_rate_hz = -1"),
            ["probes.rate_hz", "probes.idle_rate_hz"]
        );
        assert_eq!(problems_of_probes("rate_hz = 1001"), ["probes.rate_hz"]);
        // The default of `rate_hz` is 10.
        assert_eq!(problems_of_probes("idle_rate_hz = 11"), ["probes.idle_rate_hz"]);
        assert_eq!(
            problems_of_probes("padding_bytes = 1301\nmax_per_source_hz = 0"),
            ["probes.padding_bytes", "probes.max_per_source_hz"]
        );
    }

    #[test]
    fn repeated_sources_and_missing_chronyc_are_refused() {
        assert_eq!(problems_of_clock("discipline = ['kernel', 'chrony', 'kernel']"), ["clock.discipline[2]"]);
        for missing in ["/nowhere/chronyc", "no-such-command-as-this"] {
            assert_eq!(problems_of_clock(&format!("chronyc = '{missing}'")), ["clock.chronyc"]);
            assert!(problems_of_clock(&format!("chronyc = '{missing}'\ndiscipline = ['kernel']")).is_empty());
        }
        assert!(
            problems_of_clock("chronyc = 'sh'").is_empty()
                && problems_of_clock("chronyc = '/bin/sh'").is_empty()
        );
    }

    #[test]
    fn missing_or_invalid_key_is_refused() {
        let file = tempfile::NamedTempFile::new().expect("there is room for a temporary file");
        let table = format!("key_file = {:?}", file.path());
        for (content, expected) in [("", 1), ("hello\n", 1), ("00112233445566778899aabbccddeeff\n", 0)] {
            std::fs::write(file.path(), content).expect("it can be written");
            assert_eq!(problems_of_probes(&table).len(), expected, "{content:?}");
        }
        assert_eq!(problems_of_probes("key_file = \"/nowhere/key\""), ["probes.key_file"]);
    }

    #[test]
    fn reflectors_are_refused_if_no_probes_are_sent() {
        let reflector = "reflectors = { cloud = 'udp://[::1]' }\n";
        assert!(problems_of_probes(reflector).is_empty());
        assert_eq!(problems_of_probes(&format!("{reflector}send = false")), ["probes.reflectors"]);
    }

    #[test]
    fn clock_fault_steps_out_of_order_are_refused() {
        let steps = |first: &str, second: &str| {
            format!("steps = [{{ at_s = {first}, by_ms = 3000 }}, {{ at_s = {second}, by_ms = -3000 }}]")
        };
        assert!(problems_of_clock_fault(&steps("10", "20")).is_empty());
        assert_eq!(problems_of_clock_fault(&steps("20", "10")), ["clock_fault.steps[1].at_s"]);
        assert_eq!(problems_of_clock_fault(&steps("-1", "10")), ["clock_fault.steps[0].at_s"]);
        assert_eq!(problems_of_clock_fault(&steps("10", "10")), ["clock_fault.steps[1].at_s"]);
        let steps_of_both_clocks =
            "steps = [{ at_s = 10, by_ms = 39 }, { at_s = 10, by_ms = 39, clock = \"raw\" }]";
        assert!(problems_of_clock_fault(steps_of_both_clocks).is_empty());
        let too_many: Vec<String> =
            (1..=1001).map(|seconds| format!("{{ at_s = {seconds}, by_ms = 1 }}")).collect();
        assert_eq!(
            problems_of_clock_fault(&format!("steps = [{}]", too_many.join(", "))),
            ["clock_fault.steps"]
        );
        assert_eq!(
            problems_of_clock_fault("offset_ms = inf\ndrift_ppm = nan"),
            ["clock_fault.offset_ms", "clock_fault.drift_ppm"]
        );
    }
}
