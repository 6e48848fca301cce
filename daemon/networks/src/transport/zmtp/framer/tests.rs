//! Tests of the framer of ZMTP.

use proptest::prelude::*;

use super::*;

const BUDGET: u64 = 4 * 1024 * 1024;

fn allowance(stage: Stage) -> Allowance {
    Allowance {
        stage,
        max_message_bytes: 1024 * 1024,
        unadmitted: MemoryBudget::new(BUDGET),
        admitted: MemoryBudget::new(BUDGET),
    }
}

/// Returns a framer that has received the greeting.
fn greeted_framer(allowance: &Allowance) -> Framer {
    let mut framer = Framer::new(allowance);
    let mut out = Vec::new();
    framer.receive(&[7; GREETING_BYTES], allowance, &mut out).expect("a greeting is let through");
    assert_eq!(out.iter().map(|piece| piece.bytes.len()).sum::<usize>(), GREETING_BYTES);
    framer
}

fn frame(flags: u8, body: &[u8]) -> Vec<u8> {
    let mut frame = header(flags, body.len() as u64);
    frame.extend_from_slice(body);
    frame
}

/// Returns the header of a frame that claims `claimed_bytes` bytes.
fn header(flags: u8, claimed_bytes: u64) -> Vec<u8> {
    match u8::try_from(claimed_bytes) {
        Ok(short) => vec![flags, short],
        Err(_) => [&[flags | LONG][..], &claimed_bytes.to_be_bytes()].concat(),
    }
}

#[test]
fn claimed_length_reserves_no_memory() {
    let allowance = allowance(Stage::Admitted);
    let mut framer = greeted_framer(&allowance);
    framer.receive(&header(0, 1_000_000), &allowance, &mut Vec::new()).expect("is allowed");
    assert!(allowance.admitted.reserved_bytes() <= (INITIAL_BUFFER_BYTES + FRAME_OVERHEAD_BYTES) as u64);
    drop(framer);
    assert_eq!(allowance.admitted.reserved_bytes(), 0);
}

#[test]
fn frames_above_64_kib_are_refused_before_hello() {
    let allowance = allowance(Stage::Unadmitted);
    for claimed_bytes in [MAX_UNADMITTED_BYTES as u64, 60_000_000, u64::MAX] {
        let result =
            greeted_framer(&allowance).receive(&header(0, claimed_bytes), &allowance, &mut Vec::new());
        assert_eq!(result.expect_err("the frame is too long").0, Rejection::LargeBeforeHello);
    }
    let mut framer = greeted_framer(&allowance);
    let message_frame = frame(MORE, &[0; 1_000]);
    let accepted_count =
        (0..100).map_while(|_| framer.receive(&message_frame, &allowance, &mut Vec::new()).ok()).count();
    assert_eq!(
        accepted_count,
        MAX_UNADMITTED_BYTES / (1_000 + FRAME_OVERHEAD_BYTES),
        "all frames of a message count together"
    );
}

#[test]
fn connection_that_exceeds_memory_budget_is_closed() {
    let allowance = allowance(Stage::Admitted);
    let mut framers: Vec<Framer> = (0..5).map(|_| greeted_framer(&allowance)).collect();
    let unfinished = [header(0, 1_000_000), vec![1; 999_999]].concat();
    let failures = framers
        .iter_mut()
        .filter_map(|framer| framer.receive(&unfinished, &allowance, &mut Vec::new()).err())
        .collect::<Vec<_>>();
    assert!(matches!(&failures[..], [(Rejection::NoMemory, _)]), "{failures:?}");
    framers.truncate(1);
    let mut out = Vec::new();
    framers[0].receive(&[1], &allowance, &mut out).expect("the other connections continue");
    assert!(out[0].message_memory.is_some());
}

#[test]
fn memory_is_reserved_until_message_is_dropped() {
    let allowance = allowance(Stage::Admitted);
    let mut framer = greeted_framer(&allowance);
    let mut out = Vec::new();
    let bytes = [frame(MORE, &[1; 10]), frame(0, &[2; 200_000])].concat();
    framer.receive(&bytes, &allowance, &mut out).expect("is allowed");
    drop(framer);
    assert_eq!(allowance.admitted.reserved_bytes(), 200_010 + 2 * FRAME_OVERHEAD_BYTES as u64);
    out.clear();
    assert_eq!(allowance.admitted.reserved_bytes(), 0);
}

#[test]
fn long_frame_is_read_into_own_buffer() {
    let allowance = allowance(Stage::Admitted);
    let mut framer = greeted_framer(&allowance);
    let mut out = Vec::new();
    framer.receive(&[header(0, 300_000), vec![1; 100]].concat(), &allowance, &mut out).expect("is allowed");
    let mut reads = 0;
    while let Some(mut buffer) = framer.direct_buffer(&allowance).expect("there is memory") {
        let capacity = buffer.remaining_mut();
        buffer.put_bytes(1, capacity);
        framer.complete_direct_read(&allowance, &mut out).expect("is allowed");
        reads += 1;
    }
    assert_eq!(
        out.last().map(|piece| (piece.bytes.len(), piece.message_memory.is_some())),
        Some((300_000, true))
    );
    assert_eq!(reads, 5, "each read takes at most 64 KiB");
    // The whole memory of the next frame of this length is reserved at once. A read still takes at most 64 KiB.
    framer.receive(&header(0, 300_000), &allowance, &mut out).expect("is allowed");
    let capacity =
        framer.direct_buffer(&allowance).expect("there is memory").map(|buffer| buffer.remaining_mut());
    assert_eq!((capacity, framer.reserved_bytes() >= 300_000), (Some(64 << 10), true));
}

proptest! {
    #[test]
    fn frames_are_read_from_any_chunks(
        frames in proptest::collection::vec((any::<bool>(), 0..70_000_usize), 1..8),
        cuts in proptest::collection::vec(1..40_000_usize, 1..40),
    ) {
        let allowance = allowance(Stage::Admitted);
        let mut framer = greeted_framer(&allowance);
        let bytes: Vec<u8> = frames
            .iter()
            .flat_map(|(more, length)| frame(u8::from(*more), &vec![*length as u8; *length]))
            .collect();
        let (mut rest, mut out, mut cuts) = (&bytes[..], Vec::new(), cuts.iter().cycle());
        while !rest.is_empty() {
            let chunk_bytes = rest.len().min(*cuts.next().expect("cycles"));
            framer.receive(&rest[..chunk_bytes], &allowance, &mut out).expect("is allowed");
            rest = &rest[chunk_bytes..];
        }
        let joined: Vec<u8> = out.iter().flat_map(|piece| piece.bytes.to_vec()).collect();
        prop_assert_eq!(joined, bytes);
        let ends = out.iter().filter(|piece| piece.message_memory.is_some()).count();
        prop_assert_eq!(ends, frames.iter().filter(|(more, _)| !more).count());
    }

    #[test]
    fn arbitrary_bytes_stay_within_memory_budget(
        chunks in proptest::collection::vec(proptest::collection::vec(any::<u8>(), 0..3_000), 0..40),
        stage in prop_oneof![Just(Stage::Handshake), Just(Stage::Unadmitted), Just(Stage::Admitted)],
    ) {
        let allowance = allowance(stage);
        let mut framer = greeted_framer(&allowance);
        let mut out = Vec::new();
        for chunk in chunks {
            if framer.receive(&chunk, &allowance, &mut out).is_err() {
                break;
            }
            let reserved_bytes = allowance.admitted.reserved_bytes() + allowance.unadmitted.reserved_bytes();
            prop_assert!(reserved_bytes <= BUDGET);
            if stage == Stage::Unadmitted {
                let unfinished = framer.reserved_bytes();
                prop_assert!(unfinished <= (MAX_UNADMITTED_BYTES + FRAME_OVERHEAD_BYTES) as u64, "{}", unfinished);
            }
        }
        drop((framer, out));
        prop_assert_eq!(allowance.admitted.reserved_bytes() + allowance.unadmitted.reserved_bytes(), 0);
    }
}
