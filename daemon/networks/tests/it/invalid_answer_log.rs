//! Tests of the log lines about unreadable messages from a cloud.

use std::fmt::{self, Write};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use peernet_networks::{AwaitedEvent, RequestError};
use serde::Serialize;
use tracing::field::{Field, Visit};
use tracing::{Event, Level, Metadata, Subscriber, span};

use crate::fake_cloud::FakeCloud;
use crate::support::{request, within};
use crate::wire::{Departure, Header, Id, Outcome};

/// A reply whose epoch may be outside the valid range.
#[derive(Serialize)]
#[serde(rename_all = "kebab-case")]
enum UnreadableHeader {
    Reply(Id, u64, Option<Departure>, i64, Outcome),
}

/// Subscriber that collects warnings as texts.
#[derive(Clone, Default)]
struct Warnings(Arc<Mutex<Vec<String>>>);

struct FieldText(String);

impl Visit for FieldText {
    fn record_debug(&mut self, field: &Field, value: &dyn fmt::Debug) {
        write!(self.0, "{field}={value:?} ").expect("a text takes everything");
    }
}

impl Subscriber for Warnings {
    fn enabled(&self, metadata: &Metadata<'_>) -> bool {
        *metadata.level() <= Level::WARN
    }

    fn new_span(&self, _: &span::Attributes<'_>) -> span::Id {
        span::Id::from_u64(1)
    }

    fn record(&self, _: &span::Id, _: &span::Record<'_>) {}

    fn record_follows_from(&self, _: &span::Id, _: &span::Id) {}

    fn event(&self, event: &Event<'_>) {
        let mut text = FieldText(String::new());
        event.record(&mut text);
        self.0.lock().expect("no panic").push(text.0);
    }

    fn enter(&self, _: &span::Id) {}

    fn exit(&self, _: &span::Id) {}
}

#[tokio::test]
async fn unreadable_answers_are_logged_once_with_cloud_and_error() {
    let warnings = Warnings::default();
    // The test and the session share one thread, so this subscriber gets the session's log lines.
    let _guard = tracing::subscriber::set_default(warnings.clone());
    let cloud = FakeCloud::start().await;
    let (session, edge_identity, id) = cloud.session().await;
    for _ in 0..2 {
        let pending = request(&session, "x", Duration::from_millis(300));
        let (_, header) = cloud.receive_message().await;
        let Header::Request(_, number, ..) = header else { panic!("{header:?}") };
        // The epoch of the arrival is above the largest valid epoch.
        let reply =
            UnreadableHeader::Reply(id.clone(), number, None, i64::MAX, Outcome::Failed(String::new()));
        cloud.send_message(&edge_identity, &reply, Vec::new()).await;
        let completed = within(pending).await.expect("no panic");
        assert_eq!(completed.result, Err(RequestError::Timeout(AwaitedEvent::Answer)));
    }
    let lines = warnings.0.lock().expect("no panic").clone();
    assert!(session.statistics().malformed_messages >= 2);
    let [line] = &lines[..] else { panic!("{lines:?}") };
    for expected in ["dropped an invalid message", "cloud=fake", "invalid value: integer"] {
        assert!(line.contains(expected), "{line}");
    }
}
