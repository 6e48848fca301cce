//! Tests of the page's title and of the meanings of its verdicts.

use peernet_stream::DelaySecond;

use super::super::finding::{meanings, title};
use super::super::*;
use crate::tests::samples::{link, snapshot};
use crate::zone::Zone;

#[test]
fn title_says_whether_delays_can_be_trusted() {
    let title_of = |link: &LinkSnapshot| title(&Subject::live(link), Zone::Utc);
    let mixed = link(Some(0.00065), &[]);
    assert_eq!(
        title_of(&mixed),
        "cam-1 → rack-a: upload times can be trusted to ±0.65\u{202f}ms; read download times as intervals"
    );
    assert_eq!(
        title_of(&link(Some(0.00005), &[])),
        "cam-1 → rack-a: upload and download times can be trusted to ±0.050\u{202f}ms"
    );
    assert!(title_of(&link(Some(0.004), &[])).contains("read delays as intervals"));
    // The true offset may be farther from the estimate than half the width of its bounds.
    let mut off_centre = link(Some(0.0005), &[]);
    let offset = off_centre.live.latest_sample.offset.as_mut().expect("known");
    offset.estimate = offset.bounds.lo + Span::from_micros(100);
    assert!(
        title_of(&off_centre).contains(" can be trusted to ±0.90\u{202f}ms"),
        "{}",
        title_of(&off_centre)
    );
    assert!(title_of(&link(None, &[])).contains("were never related"));
    let mut one_clock = link(Some(0.0), &[]);
    one_clock.live.same_clock = true;
    assert_eq!(title_of(&one_clock), "cam-1 and rack-a read one clock: delays between them are exact");
    let mut away = mixed.clone();
    away.connected = false;
    assert!(
        title_of(&away).contains("last reported this link on 19 Nov 2026, 12:01:07"),
        "{}",
        title_of(&away)
    );
    let mut silent = mixed;
    silent.history.iter_mut().for_each(|point| {
        let point = Arc::make_mut(point);
        (point.up, point.down) = (None, None);
    });
    assert!(title_of(&silent).contains("nothing was sent in the last 10"), "{}", title_of(&silent));
}

#[test]
fn page_and_list_judge_delays_alike() {
    let titles = |link: &LinkSnapshot| {
        let links = vec![Arc::new(link.clone())];
        let list = list::title(&LiveState { links, ..snapshot(Vec::new(), Vec::new()) });
        (list, title(&Subject::live(link), Zone::Utc))
    };
    let (list, page) = titles(&link(Some(0.00065), &[]));
    assert!(list.contains("known only as intervals") && page.ends_with("as intervals"), "{list}; {page}");
    // The clocks were related again in the newest second.
    let mut stepped = link(Some(0.00005), &[]);
    for point in stepped.history.iter_mut().rev().skip(1).map(Arc::make_mut) {
        point.offset = None;
        let delays = [&mut point.up, &mut point.down].into_iter().flatten();
        delays.for_each(|delays| delays.verdict = Verdict::Stepped);
    }
    let (list, page) = titles(&stepped);
    assert!(list.contains("cannot be trusted") && page.contains("a clock was stepped"), "{list}; {page}");
    stepped.live.same_clock = true;
    let (list, page) = titles(&stepped);
    assert!(list.contains("can be trusted") && page.ends_with("are exact"), "{list}; {page}");
}

#[test]
fn verdicts_are_explained_with_numbers_of_the_link() {
    let link = link(Some(0.00065), &[]);
    let explanations = meanings(&Subject::live(&link));
    assert_eq!(
        explanations[0].text,
        "takes 6.30\u{202f}ms, 9.7 times half the width of its interval. The true value lies between 5.65 and 6.95\u{202f}ms."
    );
    assert_eq!(
        explanations[1].text,
        "takes about 0.60\u{202f}ms, too little for the width of its interval. Read it as 0.00 – 1.25\u{202f}ms: the true value can be \
         anywhere in it."
    );
}

#[test]
fn narrow_limited_delays_are_attributed_to_suspected_jump() {
    let mut link = link(Some(0.00005), &[]);
    for point in link.history.iter_mut().map(Arc::make_mut) {
        let delays = [&mut point.up, &mut point.down].into_iter().flatten();
        delays.for_each(|delays| delays.verdict = Verdict::Limited);
    }
    let subject = Subject::live(&link);
    let text = title(&subject, Zone::Utc);
    assert!(text.contains("read delays as intervals"), "{text}");
    for meaning in meanings(&subject) {
        assert!(meaning.text.contains("a jump of a clock was suspected"), "{}", meaning.text);
    }
}

#[test]
fn stale_offset_with_enough_exchanges_has_two_possible_reasons() {
    let mut link = link(Some(0.00065), &[]);
    link.live.latest_sample.offset.as_mut().expect("known").verdict = Verdict::Stale;
    let text = title(&Subject::live(&link), Zone::Utc);
    assert!(text.contains("not compared lately, or the newest exchanges contradict the others"), "{text}");
}

#[test]
fn verdict_ignores_first_seconds_of_link() {
    // While the clocks are not yet related, the verdict is `stale`.
    let mut young = link(Some(0.00005), &[]);
    young.history.drain(..119);
    young.live.latest_sample.offset.iter_mut().for_each(|offset| {
        (offset.verdict, offset.exchanges) = (Verdict::Stale, 2);
    });
    let subject = Subject::live(&young);
    assert!(title(&subject, Zone::Utc).contains("too few exchanges yet"), "{}", title(&subject, Zone::Utc));
    assert_eq!(subject.verdict(), Some(Verdict::Stale));

    // Later seconds decide the verdict without the stale first second.
    let mut link = link(Some(0.00005), &[]);
    link.history.drain(..115);
    let first = Arc::make_mut(&mut link.history[0]);
    first.up = first.up.map(|second| DelaySecond { verdict: Verdict::Stale, ..second });
    let subject = Subject::live(&link);
    assert_eq!(
        (subject.verdict(), subject.delays(Direction::Up).verdict),
        (Some(Verdict::Ok), Some(Verdict::Ok))
    );
    // A second with a bad verdict counts if it is later than the first exchanges.
    let later = Arc::make_mut(&mut link.history[3]);
    later.up = later.up.map(|second| DelaySecond { verdict: Verdict::Stepped, ..second });
    assert_eq!(Subject::live(&link).delays(Direction::Up).verdict, Some(Verdict::Stepped));
}
