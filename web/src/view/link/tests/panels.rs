//! Tests of the numbers and panels next to the chart.

use peernet_clock::{DelaySource, Interval};
use peernet_stream::{EstimateBasis, HostClock, ProbeCounts, Probing, ReflectorLive};

use super::super::*;
use super::time_series;
use crate::tests::samples::link;

#[test]
fn claim_is_formatted_as_error_and_uncertainty() {
    let claim = |lo, hi| {
        let error = Interval { lo: Span::from_micros(lo), hi: Span::from_micros(hi) };
        let claim = peernet_clock::ClockClaim { source: DelaySource::Chrony, error };
        panels::reported_error_bounds(&HostClock { claim: Some(claim), ..HostClock::default() })
    };
    assert_eq!(claim(-1_800, 2_100), "within ±2.1\u{202f}ms of true time");
    assert_eq!(claim(4_001_040, 4_001_120), "+4,001.080\u{202f}ms from true time, ±0.040\u{202f}ms");
    assert_eq!(panels::reported_error_bounds(&HostClock::default()), "—");
}

#[test]
fn no_clock_is_ahead_if_bounds_contain_zero() {
    let mut level = link(Some(0.000_004), &[]);
    let offset = level.live.latest_sample.offset.as_mut().expect("known");
    let half = Span::from_nanos(4_000);
    (offset.estimate, offset.skew_ppm) = (Span::from_nanos(-300), Some(0.02));
    offset.bounds = Interval { lo: offset.estimate - half, hi: offset.estimate + half };
    let stats = stats::all(&Subject::live(&level), &time_series(&level));
    let line = |name: &str| stats.iter().find(|stat| stat.name == name).expect("a figure").line.clone();
    assert_eq!(line("Clock offset"), "neither clock is known to be ahead, ±0.004\u{202f}ms");
    assert_eq!(line("Drift"), "both run equally fast");
}

#[test]
fn clock_is_ahead_if_bounds_exclude_zero() {
    let mut ahead = link(Some(0.000_004), &[]);
    // The estimate is not in the middle of its bounds: the true offset is up to 0.1 ms below or 0.9 ms above it.
    let [lo, estimate, hi] = [5_500, 5_600, 6_500].map(Span::from_micros);
    let offset = ahead.live.latest_sample.offset.as_mut().expect("known");
    (offset.estimate, offset.bounds) = (estimate, Interval { lo, hi });
    let stats = stats::all(&Subject::live(&ahead), &time_series(&ahead));
    let stat = stats.iter().find(|stat| stat.name == "Clock offset").expect("a figure");
    assert_eq!(stat.number, "+5.60");
    assert!(stat.line.ends_with("is ahead, ±0.90\u{202f}ms"), "{}", stat.line);
}

/// A named reflector is a further reflector that the configuration names for a cloud.
#[test]
fn named_reflector_is_shown_as_tied_to_no_host() {
    let mut link = link(Some(0.00065), &[]);
    assert!(panels::reflector(&Subject::live(&link)).is_empty());
    let known = link.live.latest_sample.offset.clone().expect("known");
    let silent = ReflectorLive {
        address: "udp://192.0.2.7:862".into(),
        probing: Probing::Unanswered { address: "udp://192.0.2.7:862".into(), reason: None },
        probes: ProbeCounts { sent: 12, answered: 0, lost: 9, refused: 3 },
        round_trip: None,
        offset: None,
    };
    let answering = ReflectorLive {
        round_trip: link.live.latest_sample.round_trip,
        offset: Some(known),
        ..silent.clone()
    };
    let mut panel_text = |reflector: ReflectorLive| {
        link.live.reflector = Some(reflector);
        let pairs = panels::reflector(&Subject::live(&link));
        let text = pairs.into_iter().map(|(name, text)| format!("{name}: {text}\n")).collect::<String>();
        text.replace('\u{202f}', " ")
    };
    let text = panel_text(silent);
    for part in [
        "12 sent, 0 answered, 9 lost, 3 refused",
        "none lately",
        "not known yet",
        "no delay is computed with it",
    ] {
        assert!(text.contains(part), "{part}: {text}");
    }
    let text = panel_text(answering);
    for part in
        ["Configured: udp://192.0.2.7:862", "Round trip: 1.30 ms at least", "its wall clock minus cam-1's"]
    {
        assert!(text.contains(part), "{part}: {text}");
    }
}

#[test]
fn basis_of_bounds_lists_assumptions_and_proven_skew() {
    let mut link = link(Some(0.00065), &[]);
    let basis = EstimateBasis {
        clocks: RelatedClocks::Raw,
        max_drift_change_ppm_per_s: Some(1.0),
        proven_skew_ppm: Some((61.5, 64.0)),
        oldest_exchange_age: Some(Span::from_seconds(42)),
        claims_trusted: false,
        probes_authenticated: Some(false),
        ..EstimateBasis::default()
    };
    link.live.latest_sample.basis = Some(basis);
    let subject = Subject::live(&link);
    let pairs = basis::pairs(&subject, &time_series(&link));
    let value_of = |name: &str| {
        let found = pairs.iter().find(|(known, _)| *known == name);
        found.map_or_else(String::new, |(_, text)| text.replace('\u{202f}', " "))
    };
    assert!(
        value_of("Clocks related").starts_with("the free-running clocks of both hosts (CLOCK_MONOTONIC_RAW)"),
        "{pairs:?}"
    );
    assert_eq!(value_of("Assumed drift"), "at most 50.0 ppm (ρ)");
    assert_eq!(
        value_of("Proven drift"),
        "between +61.5 and +64.0 ppm, beyond what is assumed: raise [clock] max_drift_ppm on cam-1 above 62"
    );
    assert!(value_of("Window").starts_with("grown to 42 s because exchanges are rare"), "{pairs:?}");
    assert_eq!(value_of("Claims of time daemons"), "shown for comparison only");
    assert!(value_of("Probes").starts_with("not authenticated"), "{pairs:?}");
    assert_eq!(stats::all(&subject, &time_series(&link))[2].name, "Offset of the free-running clocks");
    // The offset of this link is narrowed by a claim.
    assert_eq!(basis::trust_remarks(&subject), ["bounds as claimed by chrony", "probes not authenticated"]);

    // Two hosts with one clock have no offset to show.
    link.live.same_clock = true;
    assert!(basis::pairs(&Subject::live(&link), &time_series(&link)).is_empty());
}

#[test]
fn clock_that_a_hypervisor_supplies_is_named() {
    let clock = |source: Option<&str>| HostClock {
        text: "chrony, stratum 2".into(),
        clocksource: source.map(str::to_owned),
        ..HostClock::default()
    };
    for source in [None, Some("tsc"), Some("arch_sys_counter")] {
        assert_eq!(panels::describe_synchronisation(&clock(source)), "chrony, stratum 2");
    }
    let supplied = panels::describe_synchronisation(&clock(Some("kvm-clock")));
    assert_eq!(supplied, "chrony, stratum 2; clock supplied by the hypervisor (kvm-clock)");
    let hardware = panels::describe_synchronisation(&clock(Some("hpet")));
    assert_eq!(hardware, "chrony, stratum 2; clock source hpet instead of the processor's counter");
}
