//! Tests of the statistics of a connection at both ends, and of the statistics that come from the kernel.

use peernet_clock::Span;
use peernet_networks::outgoing_interface;
use peernet_stream::ConnectionStatistics;

use crate::support::{Cloud, TIME_LIMIT, echo, recorder, request, sample, settings, within};

#[tokio::test]
async fn both_ends_count_same_bytes_and_messages() {
    let mut cloud = Cloud::start().await;
    let (session, _) = cloud.session(settings()).await;
    for size in [0, 10, 300_000] {
        let pending = tokio::spawn({
            let session = session.clone();
            async move { session.request(recorder(), &sample(&"x".repeat(size)), TIME_LIMIT).await }
        });
        let incoming = cloud.next_request().await;
        incoming.reply.send(incoming.recorder, Ok(sample("answer")));
        assert!(within(pending).await.expect("no panic").result.is_ok());
    }
    let (edge_statistics, listener_statistics) = (session.statistics(), cloud.listener.statistics());
    // The edge sends the hello and three samples, and receives the acceptance and three answers.
    assert_eq!((edge_statistics.sent.messages, edge_statistics.received.messages), (4, 4));
    assert!(edge_statistics.sent.bytes > 300_010, "{edge_statistics:?}");
    let totals = |statistics: &ConnectionStatistics| {
        [statistics.sent, statistics.received].map(|direction| (direction.messages, direction.bytes))
    };
    let mut reversed_totals = totals(&listener_statistics);
    reversed_totals.reverse();
    assert_eq!(totals(&edge_statistics), reversed_totals);

    // The cloud's report has the counts at the time of the report.
    let reader = session.statistics_reader();
    assert_eq!(reader.peer(), None, "nothing was reported yet");
    cloud.listener.announcer().report_statistics();
    let mut peer_statistics = session.peer_statistics();
    within(peer_statistics.wait_for(Option::is_some)).await.expect("the session is open");
    let peer = reader.peer().expect("the cloud has reported");
    assert_eq!(totals(&peer), totals(&listener_statistics), "the report itself is not counted yet");
    assert!(peer.round_trip.is_some() && peer.sent.retransmitted.is_some(), "{peer:?}");
    assert_eq!((peer.malformed_messages, peer.lost_messages), (0, 0));

    // The kernel has statistics of each connection only, not of a listener.
    assert_eq!((listener_statistics.round_trip, listener_statistics.sent.retransmitted), (None, None));
}

#[tokio::test]
async fn cloud_counts_acknowledgements_of_partial_answers() {
    let mut cloud = Cloud::start().await;
    let (session, _) = cloud.session(settings()).await;
    let pending = request(&session, "count", TIME_LIMIT);
    let incoming = cloud.next_request().await;
    let partial_answers = incoming.partial_answers.clone();
    // More partial answers than may be unread, so the edge has to acknowledge some.
    let sending =
        tokio::task::spawn_blocking(move || (0..300).try_for_each(|_| partial_answers.send(&sample("part"))));
    let sent = tokio::select! {
        sent = within(sending) => sent.expect("no panic"),
        incoming = cloud.next() => panic!("unexpected {incoming:?}"),
    };
    assert_eq!(sent, Ok(()));
    incoming.reply.send(incoming.recorder, Ok(sample("whole")));
    assert!(within(pending).await.expect("no panic").result.is_ok());
    // TCP keeps the order, so the cloud has read all earlier messages when it answers this request.
    echo(&mut cloud, &session, "next").await;

    cloud.listener.announcer().report_statistics();
    let mut peer_statistics = session.peer_statistics();
    within(peer_statistics.wait_for(Option::is_some)).await.expect("the session is open");
    let peer = session.statistics_reader().peer().expect("the cloud has reported");
    let sent = session.statistics().sent;
    assert!(sent.messages > 3, "the hello, two requests and acknowledgements: {sent:?}");
    assert_eq!((peer.received.messages, peer.received.bytes), (sent.messages, sent.bytes));
}

#[tokio::test]
async fn tcp_connection_has_round_trip_and_interface() {
    let mut cloud = Cloud::start().await;
    let (session, _) = cloud.session(settings()).await;
    let reader = session.statistics_reader();
    let statistics = reader.read().expect("the session is open");
    let trip = statistics.round_trip.expect("the handshake was acknowledged");
    assert!(trip.smoothed > Span::ZERO && trip.smoothed < Span::from_seconds(1), "{trip:?}");
    assert!(statistics.sent.datagrams.is_some_and(|segments| segments > 0), "{statistics:?}");
    assert!(statistics.sent.retransmitted.is_some(), "{statistics:?}");
    assert_eq!(
        (statistics.sent.lost, statistics.received.retransmitted),
        (None, None),
        "the kernel does not count these"
    );

    let addresses = reader.addresses().expect("a TCP connection has addresses");
    assert_eq!(addresses.remote.port(), cloud.address().port());
    let interface = outgoing_interface(&addresses)
        .expect("interfaces are listed")
        .expect("the connection has an interface");
    assert_eq!((interface.name.as_str(), interface.kind.as_deref()), ("lo", Some("loopback")));

    session.close().await;
    drop(session);
    assert_eq!(reader.read(), None);
}
