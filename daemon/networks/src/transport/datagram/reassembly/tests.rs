//! Tests of reassembly with lost, duplicated, reordered and forged fragments.

use proptest::prelude::*;

use super::*;
use crate::transport::datagram::fragment::OutgoingMessage;

const LIMITS: ReassemblyLimits = ReassemblyLimits {
    max_message_bytes: 100_000,
    max_unfinished_messages: 8,
    timeout: Span::from_millis(100),
    idle_timeout: Span::from_seconds(5),
};

fn time_at(millis: i64) -> MonoTime {
    MonoTime::default() + Span::from_millis(millis)
}

/// Splits a message's bytes into fragments of `stride` bytes.
fn fragments(sequence: u64, bytes: &[u8], stride: u16) -> Vec<Fragment<'_>> {
    let total_bytes = bytes.len() as u32;
    let checksum = crc32fast::hash(bytes);
    let fragment_at = |(index, bytes)| Fragment {
        sequence,
        tag: sequence + 1,
        offset: index as u32 * u32::from(stride),
        total_bytes,
        checksum,
        stride,
        lifetime_ms: 0,
        bytes,
    };
    bytes.chunks(stride.into()).enumerate().map(fragment_at).collect()
}

fn with_budget(budget: u64) -> Reassembly {
    Reassembly::new(LIMITS, MemoryBudget::new(budget))
}

#[test]
fn loss_states_number_of_received_fragments() {
    let mut reassembly = with_budget(1 << 20);
    let bytes = vec![7; 950];
    for (n, fragment) in fragments(0, &bytes, 100).iter().enumerate() {
        if n != 3 {
            assert!(matches!(reassembly.receive(fragment, time_at(0)), ReassemblyOutcome::Stored));
        }
    }
    reassembly.tick(time_at(1_000));
    assert_eq!(reassembly.take_lost(), [], "the other end may not have sent the missing fragment yet");
    // The other end has sent all messages below number 1.
    reassembly.note_sent(1, time_at(1_000));
    reassembly.tick(time_at(1_099));
    assert_eq!(reassembly.take_lost(), []);
    reassembly.tick(time_at(1_100));
    assert_eq!(reassembly.take_lost(), [LostMessage { sequence: 0, tag: Some(1), received: 9, total: 10 }]);
    assert_eq!((reassembly.floor(), reassembly.budget.reserved_bytes()), (1, 0));
    let outcome = reassembly.receive(&fragments(0, &bytes, 100)[3], time_at(1_101));
    assert!(matches!(outcome, ReassemblyOutcome::Duplicate), "{outcome:?}");
}

#[test]
fn message_is_lost_if_no_fragment_follows_in_time() {
    let mut reassembly = with_budget(1 << 20);
    let bytes = [7; 200];
    reassembly.receive(&fragments(0, &bytes, 100)[0], time_at(0));
    reassembly.tick(time_at(4_999));
    assert_eq!(reassembly.take_lost(), []);
    reassembly.tick(time_at(5_000));
    assert_eq!(reassembly.take_lost().len(), 1);
}

#[test]
fn sent_message_waits_for_reassembly_timeout_only() {
    let limits = ReassemblyLimits { timeout: Span::from_seconds(10), ..LIMITS };
    let mut reassembly = Reassembly::new(limits, MemoryBudget::new(1 << 20));
    let bytes = [7; 200];
    reassembly.receive(&fragments(0, &bytes, 100)[0], time_at(0));
    reassembly.note_sent(1, time_at(0));
    reassembly.tick(time_at(9_999));
    assert_eq!(reassembly.take_lost(), [], "the idle timeout is 5 s");
    reassembly.tick(time_at(10_000));
    assert_eq!(reassembly.take_lost().len(), 1);
}

#[test]
fn deadline_ends_message_before_timeout() {
    let mut reassembly = with_budget(1 << 20);
    let bytes = [7; 200];
    let mut fragment = fragments(0, &bytes, 100)[0];
    fragment.lifetime_ms = 30;
    reassembly.receive(&fragment, time_at(0));
    reassembly.tick(time_at(29));
    assert_eq!(reassembly.take_lost(), []);
    reassembly.tick(time_at(30));
    assert_eq!(reassembly.take_lost().len(), 1);
}

#[test]
fn missing_message_is_lost_with_zero_fragments() {
    let mut reassembly = with_budget(1 << 20);
    reassembly.note_sent(2, time_at(0));
    let outcome = reassembly.receive(&fragments(2, &[1, 2, 3], 100)[0], time_at(1));
    assert!(matches!(outcome, ReassemblyOutcome::Message { .. }), "{outcome:?}");
    reassembly.tick(time_at(100));
    let lost = |sequence| LostMessage { sequence, tag: None, received: 0, total: 0 };
    assert_eq!(reassembly.take_lost(), [lost(0), lost(1)]);
    assert!(reassembly.is_settled());
}

#[test]
fn contradicting_fragments_do_not_change_message() {
    let mut reassembly = with_budget(1 << 20);
    let bytes: Vec<u8> = (0..=255).collect();
    let all_fragments = fragments(0, &bytes, 100);
    reassembly.receive(&all_fragments[0], time_at(0));
    for contradiction in [
        Fragment { checksum: 1, ..all_fragments[1] },
        Fragment { tag: 9, ..all_fragments[1] },
        Fragment { total_bytes: 300, ..all_fragments[1] },
        Fragment { stride: 50, bytes: &bytes[..50], ..all_fragments[1] },
    ] {
        assert!(matches!(reassembly.receive(&contradiction, time_at(0)), ReassemblyOutcome::Inconsistent));
    }
    assert!(matches!(reassembly.receive(&all_fragments[0], time_at(0)), ReassemblyOutcome::Duplicate));
    reassembly.receive(&all_fragments[2], time_at(0));
    let ReassemblyOutcome::Message { bytes: message_bytes, .. } =
        reassembly.receive(&all_fragments[1], time_at(0))
    else {
        panic!("the message is whole")
    };
    assert_eq!(&message_bytes[..], &bytes[..]);
}

#[test]
fn message_with_damaged_bytes_counts_as_lost() {
    let mut reassembly = with_budget(1 << 20);
    let bytes = [7; 250];
    let mut all_fragments = fragments(0, &bytes, 100);
    all_fragments[1].bytes = &[8; 100];
    for fragment in &all_fragments[..2] {
        reassembly.receive(fragment, time_at(0));
    }
    assert!(matches!(reassembly.receive(&all_fragments[2], time_at(0)), ReassemblyOutcome::Inconsistent));
    let damaged = Fragment { bytes: &[9; 30], ..fragments(1, &[7; 30], 100)[0] };
    assert!(matches!(reassembly.receive(&damaged, time_at(0)), ReassemblyOutcome::Inconsistent));
    assert_eq!(reassembly.take_lost().len(), 2);
    assert_eq!(reassembly.budget.reserved_bytes(), 0);
}

#[test]
fn claimed_length_takes_no_memory_of_other_messages() {
    let mut reassembly = with_budget(50_000);
    let bytes = vec![7; 90_000];
    for sequence in 0..8 {
        // The first fragment of an even message, and a fragment in the middle of an odd message.
        let index = if sequence % 2 == 0 { 0 } else { 50 };
        reassembly.receive(&fragments(sequence, &bytes, 1_000)[index], time_at(0));
    }
    assert_eq!(reassembly.take_lost(), [], "eight messages claim 90 kB each, but only 8 kB have arrived");
    assert!(reassembly.budget.reserved_bytes() <= 9_000, "{}", reassembly.budget.reserved_bytes());
}

#[test]
fn unfinished_messages_and_their_memory_are_bounded() {
    let mut reassembly = with_budget(50_000);
    let bytes = vec![7; 20_000];
    for sequence in 0..6 {
        for fragment in &fragments(sequence, &bytes, 1_000)[..19] {
            reassembly.receive(fragment, time_at(0));
            assert!(reassembly.budget.reserved_bytes() <= 50_000);
        }
    }
    assert_eq!(reassembly.take_lost().len(), 4, "two messages fit into the budget");
    let small = [7; 20];
    for sequence in 100..200 {
        reassembly.receive(&fragments(sequence, &small, 10)[0], time_at(0));
        assert!(reassembly.unfinished_count <= LIMITS.max_unfinished_messages);
    }
    let oversized = Fragment {
        sequence: 200,
        total_bytes: LIMITS.max_message_bytes + 1,
        ..fragments(0, &bytes, 1_000)[0]
    };
    reassembly.receive(&oversized, time_at(0));
    assert!(reassembly.take_lost().iter().any(|lost| lost.sequence == 200));
}

#[test]
fn refused_message_displaces_no_unfinished_message() {
    let mut reassembly = with_budget(1 << 20);
    let bytes = [7; 20];
    for sequence in 0..8 {
        reassembly.receive(&fragments(sequence, &bytes, 10)[0], time_at(0));
    }
    assert_eq!(reassembly.unfinished_count, LIMITS.max_unfinished_messages);
    let total_bytes = LIMITS.max_message_bytes + 1;
    reassembly.receive(&Fragment { total_bytes, ..fragments(8, &bytes, 10)[0] }, time_at(0));
    let lost: Vec<u64> = reassembly.take_lost().iter().map(|lost| lost.sequence).collect();
    assert_eq!(lost, [8]);
}

#[test]
fn message_number_far_ahead_takes_no_memory() {
    let mut reassembly = with_budget(1 << 20);
    let bytes = [7; 20];
    reassembly.receive(&fragments(3, &bytes, 10)[0], time_at(0));
    for sequence in [u64::MAX - 2, 1 << 20, MAX_SPAN] {
        let outcome = reassembly.receive(&fragments(sequence, &bytes, 10)[0], time_at(0));
        assert!(matches!(outcome, ReassemblyOutcome::TooFarAhead), "{outcome:?}");
    }
    assert_eq!((reassembly.take_lost(), reassembly.floor()), (Vec::new(), 0));
    reassembly.note_sent(u64::MAX, time_at(0));
    assert_eq!(reassembly.take_lost().len(), 1, "only the message that had begun to arrive is reported");
    assert!(reassembly.slots.len() as u64 <= MAX_SPAN);
    reassembly.give_up_all();
    assert_eq!(reassembly.floor(), u64::MAX);
    assert_eq!(reassembly.budget.reserved_bytes(), 0);
}

/// Returns a plan of fragments: number of the message, index of the fragment, and pause before it.
fn plan() -> impl Strategy<Value = Vec<(u8, prop::sample::Index, u8)>> {
    proptest::collection::vec((0_u8..6, any::<prop::sample::Index>(), 0_u8..20), 0..400)
}

proptest! {
    #[test]
    fn every_message_is_settled_once(plan in plan(), sizes in proptest::collection::vec(1_usize..2_000, 6)) {
        let mut reassembly = with_budget(8_000);
        let messages: Vec<Vec<u8>> =
            sizes.iter().enumerate().map(|(n, size)| (0..*size).map(|i| (i * 7 + n) as u8).collect()).collect();
        let (mut now, mut delivered, mut lost) = (0, Vec::new(), Vec::new());
        for (message, fragment, pause) in plan {
            now += i64::from(pause);
            let all_fragments = fragments(message.into(), &messages[usize::from(message)], 100);
            let received = reassembly.receive(fragment.get(&all_fragments), time_at(now));
            if let ReassemblyOutcome::Message { bytes, .. } = received {
                prop_assert_eq!(&bytes[..], &messages[usize::from(message)][..]);
                delivered.push(u64::from(message));
            }
            reassembly.tick(time_at(now));
            lost.extend(reassembly.take_lost().iter().map(|lost| lost.sequence));
            prop_assert!(reassembly.budget.reserved_bytes() <= 8_000);
        }
        reassembly.note_sent(6, time_at(now));
        reassembly.tick(time_at(now + 1_000));
        lost.extend(reassembly.take_lost().iter().map(|lost| lost.sequence));
        let mut settled = [delivered, lost].concat();
        settled.sort_unstable();
        prop_assert_eq!(settled, (0..6).collect::<Vec<u64>>());
        prop_assert_eq!(reassembly.budget.reserved_bytes(), 0);
    }

    #[test]
    fn fragments_in_any_order_make_the_message(
        frame in proptest::collection::vec(any::<u8>(), 0..3_000),
        stride in 1_u16..500,
        order in any::<u64>(),
    ) {
        let (sequence, tag, deadline) = (0, 0, None);
        let mut message =
            OutgoingMessage::new(vec![frame.into()], sequence, tag, deadline).expect("the message is small");
        let mut bytes = Vec::new();
        message.take(u16::MAX, &mut bytes);
        let mut all_fragments = fragments(0, &bytes, stride);
        // The keys of the sort are pseudo-random, so the order of the fragments is arbitrary.
        let count = all_fragments.len() as u64;
        all_fragments.sort_by_key(|fragment| (u64::from(fragment.offset).wrapping_mul(order | 1)) % (count * 7 + 1));
        let mut reassembly = with_budget(1 << 20);
        let mut message_bytes = None;
        for fragment in &all_fragments {
            prop_assert!(message_bytes.is_none());
            if let ReassemblyOutcome::Message { bytes, .. } = reassembly.receive(fragment, time_at(0)) {
                message_bytes = Some(bytes);
            }
        }
        prop_assert_eq!(message_bytes.as_deref(), Some(&bytes[..]));
    }
}
