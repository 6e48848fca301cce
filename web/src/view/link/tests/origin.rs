//! Tests of the origin of a bound.

use peernet_clock::{ClockClaim, DelaySource, Interval};
use peernet_stream::{HostClock, Probing};

use super::super::chart::{OffsetView, tracks};
use super::super::finding::title;
use super::super::origin::Origin;
use super::super::*;
use super::time_series;
use crate::tests::samples::{NOW, link};
use crate::zone::Zone;

#[test]
fn unused_claims_are_listed_with_exchanges() {
    let mut link = link(Some(0.00065), &[]);
    let error = Interval { lo: Span::from_millis(-1), hi: Span::from_millis(1) };
    let claims =
        HostClock { claim: Some(ClockClaim { source: DelaySource::Chrony, error }), ..HostClock::default() };
    (link.live.edge, link.live.cloud) = (Some(claims.clone()), Some(claims));
    // The claims remain, but chrony is no longer a source of the bounds.
    if let Some(offset) = &mut link.live.latest_sample.offset {
        offset.sources.truncate(1);
    }
    let origin = Origin::of(&Subject::live(&link), &time_series(&link));
    let names: Vec<&str> = origin.rows.iter().map(|row| row.name.as_str()).collect();
    assert_eq!(names, ["in-band, 612 exchanges", "as claimed by chrony on both hosts, not used", "used"]);
    // Each of the two hosts claims ±1 ms.
    assert_eq!(origin.rows[1].width, "4.00");
    assert!(origin.hints[0].contains("is wider and does not help"), "{origin:?}");

    let close = Interval { lo: Span::from_micros(-100), hi: Span::from_micros(100) };
    for clock in [&mut link.live.edge, &mut link.live.cloud].into_iter().flatten() {
        clock.claim = Some(ClockClaim { source: DelaySource::Chrony, error: close });
    }
    let origin = Origin::of(&Subject::live(&link), &time_series(&link));
    assert!(origin.hints[0].contains("trust_time_daemons = true on cam-1"), "{origin:?}");
}

#[test]
fn narrow_bound_names_its_sources_and_needs_no_time_daemon() {
    let mut link = link(Some(0.00065), &[]);
    // Bounds of ±0.03 ms are narrower than the best round trip of 1.30 ms alone can make them.
    if let Some(offset) = &mut link.live.latest_sample.offset {
        let half = Span::from_micros(30);
        offset.bounds = Interval { lo: offset.estimate - half, hi: offset.estimate + half };
    }
    let first_reason_and_hints = |link: &LinkSnapshot| {
        let origin = Origin::of(&Subject::live(link), &time_series(link));
        (origin.why[0].clone(), origin.hints)
    };
    let (why, hints) = first_reason_and_hints(&link);
    assert!(why.contains("the offset as claimed by chrony on both hosts narrows the bounds"), "{why}");
    assert_eq!(hints, ["a shorter path between the hosts"]);
    if let Some(offset) = &mut link.live.latest_sample.offset {
        offset.sources.truncate(1);
    }
    let (why, _) = first_reason_and_hints(&link);
    assert!(
        why.contains("of different exchanges, narrow the bounds together") && !why.contains("another source"),
        "{why}"
    );
}

#[test]
fn origin_lists_sources_reasons_and_hints() {
    let mut link = link(Some(0.00065), &[]);
    let origin = Origin::of(&Subject::live(&link), &time_series(&link));
    assert_eq!(origin.title, "Where the bounds come from");
    let names: Vec<&str> = origin.rows.iter().map(|row| row.name.as_str()).collect();
    assert_eq!(names, ["in-band, 612 exchanges", "as claimed by chrony on both hosts", "intersection"]);
    assert_eq!(
        (origin.rows[2].between.as_str(), origin.rows[2].width.as_str()),
        ("1,203.35 – 1,204.65", "1.30")
    );
    assert!(
        origin.why[0].contains("took 1.30\u{202f}ms, so the bounds of the offset are about that far apart"),
        "{origin:?}"
    );
    assert!(origin.hints[0].contains("PTP or chrony on cam-1 and rack-a"), "{origin:?}");

    let claim = peernet_clock::ClockClaim {
        source: DelaySource::Chrony,
        error: Interval { lo: Span::from_micros(-900), hi: Span::from_micros(900) },
    };
    let clock = HostClock { claim: Some(claim), ..HostClock::default() };
    (link.live.edge, link.live.cloud) = (Some(clock.clone()), Some(clock));
    link.live.probing = Probing::Unanswered { address: "udp://192.0.2.5:8620".into(), reason: None };
    let origin = Origin::of(&Subject::live(&link), &time_series(&link));
    assert!(origin.hints[0].contains("open udp://192.0.2.5:8620"), "{origin:?}");
    assert!(origin.hints[1].contains("is wider and does not help"), "{origin:?}");
}

#[test]
fn disconnected_link_shows_last_offset() {
    let mut away = link(Some(0.00065), &[]);
    away.connected = false;
    away.live.latest_sample.offset = None;
    Arc::make_mut(away.history.last_mut().expect("a second")).offset = None;
    let subject = Subject::live(&away);
    assert!(subject.bound().is_some());
    let origin = Origin::of(&subject, &time_series(&away));
    assert_eq!(origin.title, "Where the bounds came from");

    let row = peernet_store::LinkRow {
        edge: away.edge,
        edge_name: away.edge_name.clone(),
        cloud: away.live.peer,
        cloud_name: away.live.peer_name.clone(),
        first: NOW,
        last: NOW,
        network: NetworkName::default(),
    };
    let past = Subject::past(&row).with_last_offset(&time_series(&away));
    let stats = stats::all(&past, &time_series(&away));
    let offset = stats.iter().find(|stat| stat.name == "Clock offset").expect("it is a figure");
    assert!(offset.line.contains("when last reported"), "{offset:?}");
    assert!(!format!("{:?}", Origin::of(&past, &time_series(&away))).contains("No exchange"));
    // Without a stored offset, nothing is known about clock steps.
    let why = Origin::of(&Subject::past(&row), &time_series(&away)).why;
    assert_eq!(why, ["No offset of the two clocks was stored in this time."]);
}

#[test]
fn known_reason_for_unanswered_probes_is_shown() {
    let mut link = link(Some(0.00065), &[]);
    let mut answers_and_hint = |reason: Option<&str>| {
        link.live.probing =
            Probing::Unanswered { address: "udp://192.0.2.5:8620".into(), reason: reason.map(str::to_owned) };
        let probes = panels::probes(&Subject::live(&link), &time_series(&link));
        (probes[1].1.clone(), Origin::of(&Subject::live(&link), &time_series(&link)).hints[0].clone())
    };
    let (answers, hint) = answers_and_hint(Some("the two ends have different keys"));
    assert!(answers.contains("different keys") && hint.contains("different keys"), "{answers} {hint}");
    let (answers, hint) = answers_and_hint(None);
    assert!(answers.contains("key_file") && hint.contains("key_file"), "{answers} {hint}");
}

/// Returns a link whose offset contradicts itself: its in-band bounds and the bounds that chrony claims have no common
/// interval. Only the first `sources` of these two sources are reported.
fn inconsistent(sources: usize) -> LinkSnapshot {
    let mut link = link(Some(0.0005), &[]);
    let ms = Span::from_millis;
    let distant_bounds = Interval { lo: ms(249), hi: ms(250) };
    let make_inconsistent = |offset: &mut Offset| {
        offset.verdict = Verdict::Inconsistent;
        offset.sources = vec![(DelaySource::InBand, offset.bounds), (DelaySource::Chrony, distant_bounds)];
        offset.sources.truncate(sources);
        offset.bounds = offset.bounds.hull(distant_bounds);
    };
    link.live.latest_sample.offset.iter_mut().for_each(make_inconsistent);
    for point in &mut link.history {
        Arc::make_mut(point).offset.iter_mut().for_each(make_inconsistent);
    }
    link
}

#[test]
fn contradictory_offset_is_shown_without_value() {
    for (sources, row, hint) in
        [(2, "no common interval", "chronyc tracking"), (1, "not to be trusted", "max_drift_ppm")]
    {
        let link = inconsistent(sources);
        let subject = Subject::live(&link);
        assert_eq!((subject.bound(), subject.verdict()), (None, Some(Verdict::Inconsistent)));
        assert_eq!(subject.drift(), Err(CONTRADICTION));
        assert!(title(&subject, Zone::Utc).contains("contradicts itself"));
        let stats = stats::all(&subject, &time_series(&link));
        let offset = stats.iter().find(|stat| stat.name == "Clock offset").expect("it is a figure");
        assert_eq!((offset.number.as_str(), offset.line.as_str()), ("—", CONTRADICTION));
        let origin = Origin::of(&subject, &time_series(&link));
        let last = origin.rows.last().expect("rows");
        assert_eq!((last.name.as_str(), last.between.as_str()), (row, "—"));
        assert!(origin.hints.iter().all(|one| one.contains(hint)), "{origin:?}");
        assert!(!format!("{origin:?}").contains('±'), "{origin:?}");
        let table = table::Row::all(&time_series(&link), Zone::Utc);
        assert!(
            table.iter().all(|row| row.offset == "—" && row.bound == "—" && row.drift == "—"),
            "{table:?}"
        );
        for view in [OffsetView::DriftRemoved, OffsetView::Measured] {
            let picture = tracks(&subject, &time_series(&link), view, &[], Zone::Utc);
            let path = |class: &str| super::chart::path(&picture.tracks[0], class);
            assert_eq!(path("band"), None);
            // The interval of chrony, the second source, is drawn although there is no band.
            assert_eq!(path("dashed").is_some(), sources == 2, "{view:?}");
        }
    }
}
