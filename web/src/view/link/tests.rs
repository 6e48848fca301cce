use peernet_clock::{DelaySource, Discipline, Interval};
use peernet_stream::{
    DelayPoint, DelaySecond, EstimateBasis, HostClock, NetworkName, ProbeCounts, Probing, ReflectorLive,
};

use super::chart::{OffsetView, tracks};
use super::course::Course;
use super::finding::{meanings, title};
use super::origin::Origin;
use super::*;
use crate::tests::samples::{NOW, clock_point, link};
use crate::zone::Zone;

fn second(count: u32, value_ms: f64, verdict: Verdict) -> DelaySecond {
    let value = Span::from_seconds_f64(value_ms / 1e3);
    let median = DelayPoint { value, bounds: Interval::exactly(value), bits_per_second: None };
    DelaySecond { count, median: Some(median), verdict }
}

fn course(link: &LinkPicture) -> Course {
    Course::live(&link.history, Subject::live(link).end, 600)
}

#[test]
fn a_link_is_found_by_its_two_names() {
    let picture = peernet_aggregator::Picture {
        links: vec![std::sync::Arc::new(link(Some(0.00065), &[]))],
        ..crate::tests::samples::picture(Vec::new(), Vec::new())
    };
    assert!(find(&picture, "cam-1~rack-a").is_some());
    for other in ["rack-a~cam-1", "cam-1", "cam-1~", "~", "cam-1~rack-a~"] {
        assert!(find(&picture, other).is_none(), "{other}");
    }
}

#[test]
fn the_median_counts_each_delay_and_a_rare_verdict_does_not_colour_the_rest() {
    let many = [second(98, 6.0, Verdict::Ok), second(1, 60.0, Verdict::Ok), second(1, 1.0, Verdict::Stepped)];
    let all = Delays::merge(Way::Up, &many);
    assert_eq!((all.value().as_str(), all.verdict, all.count), ("6.00", Some(Verdict::Ok), 100));
    let worse = Delays::merge(Way::Up, &[second(90, 6.0, Verdict::Ok), second(10, 6.0, Verdict::Stale)]);
    assert_eq!(worse.verdict, Some(Verdict::Stale));
}

#[test]
fn a_negative_delay_is_never_shown() {
    let delays = Delays::merge(Way::Down, &[second(10, -0.4, Verdict::Limited)]);
    assert_eq!((delays.value().as_str(), delays.interval()), ("—", None));
    let mut low = second(10, 0.2, Verdict::Limited);
    low.median = low.median.map(|point| DelayPoint {
        bounds: Interval { lo: Span::from_micros(-450), hi: Span::from_micros(850) },
        ..point
    });
    assert_eq!(Delays::merge(Way::Down, &[low]).interval().as_deref(), Some("0.00 – 0.85"));
}

#[test]
fn a_limited_throughput_is_shown_as_its_interval() {
    let known = |verdict| {
        let point = DelayPoint {
            value: Span::from_micros(1_000),
            bounds: Interval { lo: Span::ZERO, hi: Span::from_micros(2_000) },
            bits_per_second: Some(160e6),
        };
        Delays::merge(Way::Up, &[DelaySecond { count: 9, median: Some(point), verdict }]).throughput().0
    };
    assert_eq!(known(Verdict::Ok), "20.0");
    assert_eq!(known(Verdict::Limited), "≥ 10.0");
    assert_eq!(known(Verdict::Stepped), "—");
}

#[test]
fn the_title_answers_whether_delays_can_be_trusted() {
    let say = |link: &LinkPicture| title(&Subject::live(link), Zone::Utc);
    let mixed = link(Some(0.00065), &[]);
    assert_eq!(
        say(&mixed),
        "cam-1 → rack-a: upload times can be trusted to ±0.65\u{202f}ms, download times cannot"
    );
    assert_eq!(
        say(&link(Some(0.00005), &[])),
        "cam-1 → rack-a: upload and download times can be trusted to ±0.050\u{202f}ms"
    );
    assert!(say(&link(Some(0.004), &[])).contains("read them as intervals"));
    assert!(say(&link(None, &[])).contains("were never related"));
    let mut one = link(Some(0.0), &[]);
    one.live.same_clock = true;
    assert_eq!(say(&one), "cam-1 and rack-a read one clock: delays between them are exact");
    let mut away = mixed.clone();
    away.connected = false;
    assert!(say(&away).contains("last told of this link on 19 Nov 2026, 12:01:07"), "{}", say(&away));
    let mut silent = mixed;
    silent.history.iter_mut().for_each(|point| {
        let point = Arc::make_mut(point);
        (point.up, point.down) = (None, None);
    });
    assert!(say(&silent).contains("nothing was sent in the last 10"), "{}", say(&silent));
}

#[test]
fn the_verdicts_are_told_with_this_links_numbers() {
    let link = link(Some(0.00065), &[]);
    let told = meanings(&Subject::live(&link));
    assert_eq!(
        told[0].text,
        "takes 6.30\u{202f}ms, 9.7 times its bound of ±0.65\u{202f}ms. The true value lies between 5.65 and 6.95\u{202f}ms."
    );
    assert!(told[1].text.contains("Read it as 0.00 – 1.25\u{202f}ms"), "{}", told[1].text);
}

#[test]
fn claims_that_are_not_used_stand_beside_the_exchanges() {
    let mut link = link(Some(0.00065), &[]);
    let error = Interval { lo: Span::from_millis(-1), hi: Span::from_millis(1) };
    let claims = HostClock {
        discipline: Some(Discipline { source: DelaySource::Chrony, error }),
        ..HostClock::default()
    };
    (link.live.edge, link.live.cloud) = (Some(claims.clone()), Some(claims));
    if let Some(offset) = &mut link.live.now.offset {
        offset.sources.truncate(1);
    }
    let origin = Origin::of(&Subject::live(&link), &course(&link));
    let names: Vec<&str> = origin.rows.iter().map(|row| row.name.as_str()).collect();
    assert_eq!(names, ["in-band, 612 exchanges", "as claimed by chrony on both hosts, not used", "used"]);
    assert_eq!(origin.rows[1].width, "4.00");
    assert!(origin.hints[0].contains("trust_time_daemons = true on cam-1"), "{origin:?}");
}

#[test]
fn where_a_bound_comes_from_and_what_would_narrow_it() {
    let mut link = link(Some(0.00065), &[]);
    let origin = Origin::of(&Subject::live(&link), &course(&link));
    assert_eq!(origin.title, "Where ±0.65\u{202f}ms comes from");
    let names: Vec<&str> = origin.rows.iter().map(|row| row.name.as_str()).collect();
    assert_eq!(names, ["in-band, 612 exchanges", "as claimed by chrony on both hosts", "intersection"]);
    assert_eq!(
        (origin.rows[2].between.as_str(), origin.rows[2].width.as_str()),
        ("1,203.35 – 1,204.65", "1.30")
    );
    assert!(
        origin.why[0].contains("took 1.30\u{202f}ms, so the offset is known to half of that, ±0.65"),
        "{origin:?}"
    );
    assert!(origin.hints[0].contains("PTP or chrony on cam-1 and rack-a"), "{origin:?}");

    let claim = peernet_clock::Discipline {
        source: DelaySource::Chrony,
        error: Interval { lo: Span::from_micros(-900), hi: Span::from_micros(900) },
    };
    let clock = HostClock { discipline: Some(claim), ..HostClock::default() };
    (link.live.edge, link.live.cloud) = (Some(clock.clone()), Some(clock));
    link.live.probing = Probing::Unanswered { address: "udp://192.0.2.5:8620".into(), reason: None };
    let origin = Origin::of(&Subject::live(&link), &course(&link));
    assert!(origin.hints[0].contains("open udp://192.0.2.5:8620"), "{origin:?}");
    assert!(origin.hints[1].contains("is wider and does not help"), "{origin:?}");
}

#[test]
fn a_steady_drift_is_taken_out_of_the_picture_and_a_step_parts_it() {
    let at = |ago: i64| WallTime::from_unix_nanos((NOW.unix_seconds() - ago) * 1_000_000_000);
    let mut points: Vec<ClockPoint> =
        (0..100).rev().map(|ago| clock_point(at(ago), u64::from(ago < 50), Some(0.0005))).collect();
    points[50..].iter_mut().filter_map(|point| point.offset.as_mut()).for_each(|offset| {
        offset.estimate += Span::from_seconds(3);
    });
    let trend = trend::Trend::of(&points);
    for point in &points {
        let estimate = point.offset.as_ref().expect("known").estimate.seconds();
        assert!((estimate - trend.at(point.window, point.at)).abs() < 1e-9);
    }
}

#[test]
fn points_that_are_put_together_keep_the_widest_bounds_and_all_probes() {
    let at = |second: i64| WallTime::from_unix_nanos(second * 1_000_000_000);
    let points = vec![
        clock_point(at(11), 1, Some(0.0005)),
        clock_point(at(12), 1, Some(0.0020)),
        clock_point(at(20), 1, Some(0.0005)),
        clock_point(at(21), 1, Some(0.0005)),
    ];
    let whole = Course { from: at(10), to: at(30), bucket: 1, points };
    let thin = whole.thinned(10);
    assert_eq!(thin.points.iter().map(|point| point.at).collect::<Vec<_>>(), [at(20), at(21)]);
    let first = &thin.points[0];
    let width = first.offset.as_ref().expect("known").bounds.width().seconds();
    assert!((width - 0.004).abs() < 1e-6, "{width}");
    assert_eq!(first.probes.sent, 30);
    assert_eq!(first.up.expect("data").count, 90);
    assert_eq!(whole.gaps(), [(at(12), at(20)), (at(21), at(30))]);
}

#[test]
fn a_gap_parts_every_line_and_is_hatched() {
    let gap: Vec<i64> = (40..60).collect();
    let link = link(Some(0.00065), &gap);
    let subject = Subject::live(&link);
    let picture = tracks(&subject, &course(&link), OffsetView::Removed, &[], Zone::Utc);
    assert_eq!(picture.gaps.len(), 1);
    let offset = &picture.tracks[0];
    let band = offset.curves.iter().find(|curve| curve.class == "band").expect("a band");
    assert_eq!(band.path.matches('Z').count(), 2, "{}", band.path);
    assert!(offset.curves.iter().any(|curve| curve.class == "dashed"));
    assert!(picture.label.contains("1 stretch without a report"), "{}", picture.label);
    assert!(picture.strips[0].segments.len() == 2 && picture.strips[1].segments[0].tone == "warn");
    let html = picture.to_string();
    assert!(!html.contains("NaN") && !html.contains("inf"), "{html}");
}

#[test]
fn nothing_at_all_still_makes_a_picture() {
    let mut empty = link(None, &[]);
    empty.history.clear();
    let subject = Subject::live(&empty);
    for view in [OffsetView::Removed, OffsetView::Measured] {
        let picture = tracks(&subject, &course(&empty), view, &[], Zone::Utc);
        assert!(picture.label.contains("Nothing was reported"), "{}", picture.label);
        assert!(!picture.to_string().contains("NaN"));
    }
}

#[test]
fn a_claim_is_told_as_it_is_meant() {
    let claim = |lo, hi| {
        let error = Interval { lo: Span::from_micros(lo), hi: Span::from_micros(hi) };
        let discipline = peernet_clock::Discipline { source: DelaySource::Chrony, error };
        panels::claims(&HostClock { discipline: Some(discipline), ..HostClock::default() })
    };
    assert_eq!(claim(-1_800, 2_100), "within ±2.1\u{202f}ms of true time");
    assert_eq!(claim(4_001_040, 4_001_120), "+4,001.080\u{202f}ms from true time, ±0.040\u{202f}ms");
    assert_eq!(panels::claims(&HostClock::default()), "—");
}

#[test]
fn what_the_cloud_tells_is_placed_by_the_offset_of_its_time() {
    let at = |ago: i64| WallTime::from_unix_nanos((NOW.unix_seconds() - ago) * 1_000_000_000);
    let mut points: Vec<ClockPoint> =
        (0..60).rev().map(|ago| clock_point(at(ago), 1, Some(0.0005))).collect();
    // Half a minute ago the edge was set forward by three seconds.
    for point in &mut points[30..] {
        let offset = point.offset.as_mut().expect("known");
        offset.estimate = offset.estimate - Span::from_seconds(3);
    }
    let course = Course { from: at(60), to: at(0), bucket: 1, points };
    for ago in [50, 10] {
        let estimate = course.points[59 - ago as usize].offset.as_ref().expect("known").estimate;
        let placed = course.on_the_edge(at(ago) + estimate);
        assert!((placed - at(ago)).abs() < Span::from_millis(1), "{ago}");
    }
}

fn inconsistent(sources: usize) -> LinkPicture {
    let mut link = link(Some(0.0005), &[]);
    let ms = Span::from_millis;
    let away = Interval { lo: ms(249), hi: ms(250) };
    let spoil = |offset: &mut Offset| {
        offset.verdict = Verdict::Inconsistent;
        offset.sources = vec![(DelaySource::InBand, offset.bounds), (DelaySource::Chrony, away)];
        offset.sources.truncate(sources);
        offset.bounds = offset.bounds.hull(away);
    };
    link.live.now.offset.iter_mut().for_each(spoil);
    for point in &mut link.history {
        Arc::make_mut(point).offset.iter_mut().for_each(spoil);
    }
    link
}

#[test]
fn what_contradicts_itself_has_no_value_and_no_bound_anywhere() {
    for (sources, row, hint) in
        [(2, "no common interval", "chronyc tracking"), (1, "not to be trusted", "max_drift_ppm")]
    {
        let link = inconsistent(sources);
        let subject = Subject::live(&link);
        assert_eq!((subject.bound(), subject.verdict()), (None, Some(Verdict::Inconsistent)));
        assert!(title(&subject, Zone::Utc).contains("contradicts itself"));
        let stats = stats::all(&subject, &course(&link));
        let offset = stats.iter().find(|stat| stat.name == "Clock offset").expect("it is a figure");
        assert_eq!((offset.number.as_str(), offset.line.as_str()), ("—", CONTRADICTION));
        let origin = Origin::of(&subject, &course(&link));
        let last = origin.rows.last().expect("rows");
        assert_eq!((last.name.as_str(), last.between.as_str()), (row, "—"));
        assert!(origin.hints.iter().all(|one| one.contains(hint)), "{origin:?}");
        assert!(!format!("{origin:?}").contains('±'), "{origin:?}");
        let table = table::Row::all(&course(&link), Zone::Utc);
        assert!(table.iter().all(|row| row.offset == "—" && row.bound == "—"), "{table:?}");
        let picture = tracks(&subject, &course(&link), OffsetView::Removed, &[], Zone::Utc);
        assert!(picture.tracks[0].curves.iter().all(|curve| curve.class != "band"));
    }
}

#[test]
fn a_young_link_says_so_and_its_first_moments_do_not_colour_it() {
    let mut young = link(Some(0.00005), &[]);
    young.history.drain(..119);
    young.live.now.offset.iter_mut().for_each(|offset| {
        (offset.verdict, offset.exchanges) = (Verdict::Stale, 2);
    });
    let subject = Subject::live(&young);
    assert!(title(&subject, Zone::Utc).contains("too few exchanges yet"), "{}", title(&subject, Zone::Utc));
    assert_eq!(subject.verdict(), Some(Verdict::Stale));

    let mut link = link(Some(0.00005), &[]);
    link.history.drain(..115);
    let first = Arc::make_mut(&mut link.history[0]);
    first.up = first.up.map(|second| DelaySecond { verdict: Verdict::Stale, ..second });
    let subject = Subject::live(&link);
    assert_eq!((subject.verdict(), subject.delays(Way::Up).verdict), (Some(Verdict::Ok), Some(Verdict::Ok)));
    // One that was judged so while the clocks were known counts.
    let later = Arc::make_mut(&mut link.history[3]);
    later.up = later.up.map(|second| DelaySecond { verdict: Verdict::Stepped, ..second });
    assert_eq!(Subject::live(&link).delays(Way::Up).verdict, Some(Verdict::Stepped));
}

#[test]
fn a_link_that_fell_silent_keeps_what_it_told() {
    let mut away = link(Some(0.00065), &[]);
    away.connected = false;
    away.live.now.offset = None;
    Arc::make_mut(away.history.last_mut().expect("a second")).offset = None;
    let subject = Subject::live(&away);
    assert!(subject.bound().is_some());
    let origin = Origin::of(&subject, &course(&away));
    assert_eq!(origin.title, "Where ±0.65\u{202f}ms came from");

    let row = peernet_store::LinkRow {
        edge: away.edge,
        edge_name: away.edge_name.clone(),
        cloud: away.live.peer,
        cloud_name: away.live.peer_name.clone(),
        first: NOW,
        last: NOW,
        network: NetworkName::default(),
    };
    let past = Subject::past(&row).remembering(&course(&away));
    let stats = stats::all(&past, &course(&away));
    let offset = stats.iter().find(|stat| stat.name == "Clock offset").expect("it is a figure");
    assert!(offset.line.contains("when last told"), "{offset:?}");
    assert!(!format!("{:?}", Origin::of(&past, &course(&away))).contains("No exchange"));
}

#[test]
fn an_offset_that_may_be_none_is_neither_ahead_nor_behind() {
    let mut level = link(Some(0.000_004), &[]);
    let offset = level.live.now.offset.as_mut().expect("known");
    let half = Span::from_nanos(4_000);
    (offset.estimate, offset.skew_ppm) = (Span::from_nanos(-300), Some(0.02));
    offset.bounds = Interval { lo: offset.estimate - half, hi: offset.estimate + half };
    let stats = stats::all(&Subject::live(&level), &course(&level));
    let line = |name: &str| stats.iter().find(|stat| stat.name == name).expect("a figure").line.clone();
    assert_eq!(line("Clock offset"), "level, ±0.004\u{202f}ms");
    assert_eq!(line("Drift"), "both run alike");
}

#[test]
fn points_of_another_time_neither_tilt_the_line_nor_set_the_scale() {
    let mut link = link(Some(0.000_01), &[]);
    // A clock was set back by five seconds: the second after it still holds what was known before, and the first band
    // is wide.
    for (place, point) in link.history.iter_mut().enumerate().skip(60) {
        let point = Arc::make_mut(point);
        point.window = 2;
        let offset = point.offset.as_mut().expect("known");
        let by = if place == 60 { Span::ZERO } else { Span::from_seconds(5) };
        offset.estimate += by;
        let half = if place == 61 { Span::from_millis(40) } else { Span::from_micros(10) };
        offset.bounds = Interval { lo: offset.estimate - half, hi: offset.estimate + half };
    }
    let points: Vec<ClockPoint> = link.history.iter().map(|point| (**point).clone()).collect();
    let trend = trend::Trend::of(&points);
    for point in &points[62..] {
        let residual = point.offset.as_ref().expect("known").estimate.seconds() - trend.at(2, point.at);
        assert!(residual.abs() < 1e-6, "{residual}");
    }
    let picture = tracks(&Subject::live(&link), &course(&link), OffsetView::Removed, &[], Zone::Utc);
    let top = &picture.tracks[0].ticks.last().expect("ticks").1;
    assert_eq!(top, "+0.015", "{:?}", picture.tracks[0].ticks);
}

#[test]
fn seconds_that_came_twice_are_drawn_window_by_window() {
    let at = |half_seconds: i64| WallTime::from_unix_nanos(NOW.unix_nanos() + half_seconds * 500_000_000);
    let points: Vec<ClockPoint> = (0..40).map(|n| clock_point(at(n), (n % 2) as u64, Some(0.0005))).collect();
    let whole = Course { from: at(0), to: at(40), bucket: 1, points };
    let mut picture_of = link(Some(0.0005), &[]);
    picture_of.history.clear();
    let picture = tracks(&Subject::live(&picture_of), &whole, OffsetView::Removed, &[], Zone::Utc);
    let band = picture.tracks[0].curves.iter().find(|curve| curve.class == "band").expect("a band");
    assert_eq!(band.path.matches('Z').count(), 2, "{}", band.path);
}

#[test]
fn why_probes_are_not_answered_is_told_where_it_is_known() {
    let mut link = link(Some(0.00065), &[]);
    let mut told = |reason: Option<&str>| {
        link.live.probing =
            Probing::Unanswered { address: "udp://192.0.2.5:8620".into(), reason: reason.map(str::to_owned) };
        let probes = panels::probes(&Subject::live(&link), &course(&link));
        (probes[1].1.clone(), Origin::of(&Subject::live(&link), &course(&link)).hints[0].clone())
    };
    let (answers, hint) = told(Some("the two ends have different keys"));
    assert!(answers.contains("different keys") && hint.contains("different keys"), "{answers} {hint}");
    let (answers, hint) = told(None);
    assert!(answers.contains("key_file") && hint.contains("key_file"), "{answers} {hint}");
}

#[test]
fn name_of_a_link_leaves_zmq_tcp_out() {
    let udp: NetworkName = "zmq-udp".parse().expect("a name");
    assert_eq!(name("cam-1", "rack-a", &NetworkName::default()), "cam-1~rack-a");
    assert_eq!(name("cam-1", "rack-a", &udp), "cam-1~rack-a~zmq-udp");
    for (wanted, same) in [
        ("cam-1~rack-a", "cam-1~rack-a"),
        ("cam-1~rack-a~zmq-tcp", "cam-1~rack-a"),
        ("cam-1~rack-a~zmq-udp", "cam-1~rack-a~zmq-udp"),
        ("cam-1", "cam-1"),
        ("cam-1~rack-a~zmq-udp~", "cam-1~rack-a~zmq-udp~"),
    ] {
        assert_eq!(canonical(wanted.to_owned()), same);
    }
}

#[test]
fn named_reflector_is_shown_as_tied_to_no_host() {
    let mut link = link(Some(0.00065), &[]);
    assert!(panels::reflector(&Subject::live(&link)).is_empty());
    let known = link.live.now.offset.clone().expect("known");
    let silent = ReflectorLive {
        address: "udp://192.0.2.7:862".into(),
        probing: Probing::Unanswered { address: "udp://192.0.2.7:862".into(), reason: None },
        probes: ProbeCounts { sent: 12, answered: 0, lost: 9, refused: 3 },
        round_trip: None,
        offset: None,
    };
    let answering =
        ReflectorLive { round_trip: link.live.now.round_trip, offset: Some(known), ..silent.clone() };
    let mut shown = |reflector: ReflectorLive| {
        link.live.reflector = Some(reflector);
        let pairs = panels::reflector(&Subject::live(&link));
        let text = pairs.into_iter().map(|(name, text)| format!("{name}: {text}\n")).collect::<String>();
        text.replace('\u{202f}', " ")
    };
    let text = shown(silent);
    for part in
        ["12 sent, 0 answered, 9 lost, 3 refused", "none lately", "not known yet", "no delay rests on it"]
    {
        assert!(text.contains(part), "{part}: {text}");
    }
    let text = shown(answering);
    for part in
        ["Configured: udp://192.0.2.7:862", "Round trip: 1.30 ms at least", "its wall clock minus cam-1's"]
    {
        assert!(text.contains(part), "{part}: {text}");
    }
}

#[test]
fn a_placement_uses_the_link_over_its_network() {
    let mut shown = crate::tests::samples::picture(Vec::new(), Vec::new());
    shown.links = vec![Arc::new(crate::tests::samples::link_over_udp(None))];
    let placement = |network: Option<&str>| Placement {
        kind: PlacementKind::Remote,
        peer: "rack-a".parse().ok(),
        network: network.map(str::to_owned),
        ..Placement::sensor_alone()
    };
    let page = |network| of_placement(&shown, "cam-1", &placement(network));
    assert_eq!(page(Some("zmq-udp")).as_deref(), Some("/links/cam-1~rack-a~zmq-udp"));
    assert_eq!((page(Some("zmq-tcp")), page(None), page(Some("~"))), (None, None, None));
}

#[test]
fn what_the_bounds_rest_on_is_told_with_what_is_proven() {
    let mut link = link(Some(0.00065), &[]);
    let basis = EstimateBasis {
        clocks: RelatedClocks::Raw,
        max_drift_change_ppm_per_s: Some(1.0),
        proven_skew_ppm: Some((61.5, 64.0)),
        grown_window: Some(Span::from_seconds(42)),
        claims_trusted: false,
        probes_authenticated: Some(false),
        ..EstimateBasis::default()
    };
    link.live.now.basis = Some(basis);
    let subject = Subject::live(&link);
    let pairs = basis::pairs(&subject, &course(&link));
    let of = |name: &str| {
        let found = pairs.iter().find(|(known, _)| *known == name);
        found.map_or_else(String::new, |(_, text)| text.replace('\u{202f}', " "))
    };
    assert!(
        of("Clocks related").starts_with("the free-running clocks of both hosts (CLOCK_MONOTONIC_RAW)"),
        "{pairs:?}"
    );
    assert_eq!(of("Assumed drift"), "at most 50.0 ppm (ρ)");
    assert_eq!(
        of("Proven drift"),
        "between +61.5 and +64.0 ppm, beyond what is assumed: raise [clock] max_drift_ppm on cam-1 above 62"
    );
    assert!(of("Window").starts_with("grown to 42 s because exchanges are rare"), "{pairs:?}");
    assert_eq!(of("Claims of time daemons"), "shown for comparison only");
    assert!(of("Probes").starts_with("not authenticated"), "{pairs:?}");
    assert_eq!(stats::all(&subject, &course(&link))[2].name, "Offset of the free-running clocks");
    // The offset of this link is narrowed by a claim.
    assert_eq!(basis::facts(&subject), ["bounds as claimed by chrony", "probes not authenticated"]);

    // What cannot be told of one clock is not told.
    link.live.same_clock = true;
    assert!(basis::pairs(&Subject::live(&link), &course(&link)).is_empty());
}

#[test]
fn clock_that_a_hypervisor_supplies_is_named() {
    let clock = |source: Option<&str>| HostClock {
        text: "chrony, stratum 2".into(),
        clocksource: source.map(str::to_owned),
        ..HostClock::default()
    };
    for source in [None, Some("tsc"), Some("arch_sys_counter")] {
        assert_eq!(panels::discipline(&clock(source)), "chrony, stratum 2");
    }
    let supplied = panels::discipline(&clock(Some("kvm-clock")));
    assert_eq!(supplied, "chrony, stratum 2; clock supplied by the hypervisor (kvm-clock)");
}
