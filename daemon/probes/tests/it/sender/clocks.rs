//! Tests of stamps of the kernel and of free-running clocks.

use super::*;

#[test]
fn kernel_stamps_of_another_clock_are_distrusted() {
    let (large_shift, small_shift) = (Span::from_millis(1), Span::from_nanos(900));
    // Time from the departure of the request to the arrival of the reply, with the reflector's delay of 55 µs.
    let reply_time = ONE_WAY_DELAY + ONE_WAY_DELAY + Span::from_micros(55);
    // `shift` is the time by which the kernel's stamp of the arrival is earlier than the program's. The program's clock
    // cannot have made a stamp that is later, or that is before the departure of the request; 1 µs is tolerated.
    for (shift, is_trusted) in
        [(-large_shift, false), (-small_shift, true), (small_shift, true), (reply_time + large_shift, false)]
    {
        let mut pair = Pair::new(None);
        let returned_at = pair.clock.stamp() + reply_time;
        let returned_stamp = pair.exchange_with_kernel_stamp(returned_at.wall - shift).exchange.returned;
        // Whatever the kernel's stamp is, the packet had arrived when the program read its clock.
        let applied_shift = shift.max(Span::ZERO);
        assert_eq!(
            returned_stamp,
            if is_trusted { returned_at.raw - applied_shift } else { returned_at.raw },
            "{shift}"
        );
        assert_eq!(pair.sender.ignores_kernel_stamps(), !is_trusted, "{shift}");
        let (started_at, returned_at) = (pair.clock.raw(), pair.clock.stamp() + reply_time);
        let next_exchange = pair.exchange_with_kernel_stamp(returned_at.wall - small_shift);
        assert_eq!(
            next_exchange.exchange.returned,
            if is_trusted { returned_at.raw - small_shift } else { returned_at.raw },
            "{shift}"
        );
        assert_eq!(next_exchange.exchange.sent, started_at, "{shift}");
    }
}

#[test]
fn kernel_departure_before_program_stamp_is_distrusted() {
    let mut pair = Pair::new(None);
    let (departure, packet) = pair.send();
    let departure_before_program_stamp = pair.clock.wall() - Span::from_micros(300);
    pair.sender.record_departure(
        departure.sequence(),
        departure_before_program_stamp,
        pair.clock.wall_ahead(),
    );
    let reply = pair.reflect(packet);
    pair.receive_reply(&reply).expect("an answer");
    assert!(pair.sender.ignores_kernel_stamps());
}

#[test]
fn setting_wall_clock_causes_no_distrust_of_kernel() {
    for step in [Span::from_seconds(3), -Span::from_seconds(3)] {
        let mut pair = Pair::raw(None);
        let started_at = pair.clock.raw();
        let (departure, packet) = pair.send();
        // The probe leaves the machine slightly after the program's stamp. Then the clock is set, and only then is the
        // kernel's stamp read.
        let departed_at = pair.clock.wall() + Span::from_micros(9);
        let reply = pair.reflect(packet);
        let kernel_arrival = pair.clock.wall();
        let arrival_raw = pair.clock.raw();
        pair.clock.step_wall(step);
        pair.sender.record_departure(departure.sequence(), departed_at, pair.clock.wall_ahead());
        pair.clock.advance(Span::from_micros(20));
        let arrival = pair.reply_arrival(Some(kernel_arrival));
        let reply_result = pair.sender.receive(&reply, &arrival).expect("an answer");
        let exchange = answered(&reply_result).exchange;
        assert!(
            started_at <= exchange.sent && exchange.sent <= started_at + Span::from_micros(9),
            "{exchange:?}"
        );
        assert!(arrival_raw <= exchange.returned && exchange.returned <= pair.clock.raw(), "{exchange:?}");
        assert!(exchange.bounds().contains(Span::ZERO), "{exchange:?}");
        assert!(!pair.sender.ignores_kernel_stamps());
    }
}

#[test]
fn raw_exchange_has_stamps_of_both_free_running_clocks() {
    for key in [None, Some(key(7))] {
        let mut pair = Pair::raw(key);
        let started_at = pair.clock.raw();
        let first = answered(&pair.exchange());
        assert_eq!((first.exchange.sent, first.exchange.returned), (started_at, pair.clock.raw()));
        assert_eq!(
            first.exchange.received,
            started_at + ONE_WAY_DELAY,
            "both free-running clocks show the same time"
        );
        assert_eq!(first.exchange.replied, started_at + ONE_WAY_DELAY + Span::from_micros(50));
        assert_eq!(first.cloud_epoch, Some(0));
        // Steps of wall clocks have no effect.
        pair.clock.step_wall(Span::from_seconds(60));
        pair.ahead = -Span::from_seconds(3600);
        let second = pair.exchange();
        let refined = second.refined.expect("the follow-up").exchange;
        assert_eq!(refined.replied, first.exchange.replied + Span::from_micros(5));
        assert_eq!(
            answered(&second).exchange.bounds().middle(),
            Span::from_nanos(-2_500),
            "the reply left 5 µs after its first stamp"
        );
    }
}

#[test]
fn reply_without_requested_raw_stamps_is_refused() {
    let mut pair = Pair::raw(None);
    let (_, packet) = pair.send();
    let reply = pair.reflect(packet.clone());
    let header =
        tlv::headers(&reply[44..]).find(|header| header.kind == tlv::RAW_STAMPS).expect("we ask for it");
    // Answers of a release that does not know the type, of a release that leaves the TLV empty, and of a reflector
    // without TLVs.
    let mut reply_with_unrecognised_tlv = reply.clone();
    reply_with_unrecognised_tlv[44 + header.offset] = tlv::UNRECOGNISED;
    let mut reply_with_empty_tlv = reply.clone();
    reply_with_empty_tlv[44..][header.value].copy_from_slice(&RawStamps::default().to_value());
    for incomplete_reply in [reply_with_unrecognised_tlv, reply_with_empty_tlv, reply[..44].to_vec()] {
        assert_eq!(
            pair.receive_reply(&incomplete_reply),
            Err("without the stamps of the reflector's free-running clock")
        );
    }
    assert_eq!(reply.len(), packet.len());
    assert!(pair.receive_reply(&reply).is_ok());
}
