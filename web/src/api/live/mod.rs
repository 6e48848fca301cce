//! `GET /api/v1/live`: one stream of events per page.
//!
//! Each listener takes the newest snapshot of the live state when the listener is ready, at most four times a second and less often when
//! snapshots are large. A slow listener therefore skips snapshots and never delays the others.

mod schema;

use std::collections::HashMap;
use std::convert::Infallible;
use std::hash::{DefaultHasher, Hash, Hasher};
use std::sync::Arc;
use std::time::Duration;

use axum::Extension;
use axum::extract::State;
use axum::http::{HeaderMap, HeaderName};
use axum::response::sse::{Event, KeepAlive, Sse};
use axum::response::{AppendHeaders, IntoResponse};
use futures::{Stream, StreamExt, stream};
use peernet_aggregator::{LiveState, Readiness};
use peernet_clock::WallTime;
use serde::Deserialize;
use tokio::sync::watch;
use tokio::time::Instant;
use utoipa::openapi::RefOr;
use utoipa::{IntoParams, OpenApi};
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use self::schema::{LiveStateEvent, StatusEvent};
use crate::api::schema::PipelineList;
use crate::connections::StreamSlots;
use crate::error::{ProblemDetails, WebError};
use crate::fair_slots::Slot;
use crate::pages::{self, RequestedTopic};
use crate::parameters::Parameters;
use crate::state::App;

/// Returns the operations of this resource.
pub(super) fn routes() -> OpenApiRouter<App> {
    let mut router = OpenApiRouter::with_openapi(EventSchemas::openapi()).routes(routes!(stream));
    describe_topics(router.get_openapi_mut());
    router
}

/// Describes the query parameter `topics` with the topics that the pages registered.
fn describe_topics(document: &mut utoipa::openapi::OpenApi) {
    let patterns: Vec<String> = pages::topic_patterns().map(|pattern| format!("`{pattern}`")).collect();
    // The line break after the first pattern stays, because the committed OpenAPI document has it.
    let (first, others) = patterns.split_at(1);
    let text = format!(
        "Topics, separated by commas: `picture` (all pipelines and hosts as JSON), and for the dashboard {},\n{}.\n\
         By default `picture`. At most {MAX_TOPICS} different topics; a topic that is named several times is sent once.",
        first.concat(),
        others.join(", ")
    );
    let operations = document.paths.paths.values_mut().filter_map(|item| item.get.as_mut());
    let parameters = operations.filter_map(|operation| operation.parameters.as_mut()).flatten();
    for parameter in parameters {
        if let RefOr::T(parameter) = parameter
            && parameter.name == "topics"
        {
            parameter.description = Some(text.clone());
        }
    }
}

/// The schemas of the events, which no operation names as its answer.
#[derive(OpenApi)]
#[openapi(components(schemas(LiveStateEvent, StatusEvent)))]
struct EventSchemas;

/// Minimum time between two updates of a listener.
const MIN_INTERVAL: Duration = Duration::from_millis(250);
/// Maximum average number of bytes per second to one listener. Large snapshots are sent less often.
const MAX_BYTES_PER_SECOND: usize = 512 << 10;
/// Maximum number of different topics on one stream. A page needs one.
const MAX_TOPICS: usize = 16;
/// Maximum number of seconds of each pipeline that are sent to a listener that reconnects.
const MAX_HISTORY_SECONDS: usize = 600;
/// Maximum number of seconds of all pipelines together in one event. If the missed seconds exceed this number, a listener receives only the
/// latest [`PipelineList::SECONDS`] of each pipeline, and must request the rest pipeline by pipeline.
const MAX_CATCH_UP_SECONDS: usize = 10_000;
/// Time between two heartbeats while nothing changes.
const HEARTBEAT_INTERVAL: Duration = Duration::from_secs(2);

/// Query parameters of the live stream.
#[derive(Clone, Debug, Default, Deserialize, IntoParams)]
#[serde(deny_unknown_fields, default)]
#[into_params(parameter_in = Query)]
struct Query {
    // `describe_topics` describes this parameter, because the pages define the topics.
    topics: Option<String>,
    /// Id of the last event of an earlier stream, like the header `Last-Event-ID`, which a script cannot set on a new `EventSource`.
    /// The first `picture` then has an entry for each second since that event, and for the five seconds before it. It has at most 600
    /// entries for each pipeline, and only the newest five if the entries of all pipelines would exceed 10,000. All other parts are sent as
    /// they are now.
    #[param(pattern = "^-?[0-9]+$")]
    last_event_id: Option<String>,
}

/// Subject of the events that a listener receives.
#[derive(Clone, Debug, PartialEq)]
enum Topic {
    /// Live state of all pipelines and hosts as JSON. Its public name is `picture`.
    LiveState,
    /// Parts of a page as HTML.
    Page(RequestedTopic),
}

impl Topic {
    /// Public name of the topic of the live state, and of its events.
    const LIVE_STATE: &str = "picture";

    fn parse(text: &str) -> Result<Self, WebError> {
        if text == Self::LIVE_STATE {
            return Ok(Self::LiveState);
        }
        pages::topic(text).map(Self::Page).ok_or_else(|| {
            let names: Vec<&str> = [Self::LIVE_STATE].into_iter().chain(pages::topic_patterns()).collect();
            WebError::BadRequest(format!(
                "query parameter topics: {text:?} is not a topic; use one of {}",
                names.join(", ")
            ))
        })
    }
}

/// Live figures as server-sent events: `status` always, `picture` and `page` by topic. At most four of each are sent per second, and
/// fewer if they exceed 512 KiB per second. A slow listener receives the newest events and misses earlier events. One address may
/// have at most 32 open streams, and all addresses together a quarter of the server's connections; a further stream is answered with 503.
#[utoipa::path(get, path = "/api/v1/live", operation_id = "streamLive", tag = "pipelines", params(Query), responses(
    (status = 200, description = "`event: status` (StatusEvent), `event: picture` (PictureEvent), `event: page`, `event: heartbeat`", body = String, content_type = "text/event-stream"),
    (status = "default", body = ProblemDetails, content_type = "application/problem+json"),
))]
async fn stream(
    State(app): State<App>,
    streams: Option<Extension<StreamSlots>>,
    headers: HeaderMap,
    Parameters(query): Parameters<Query>,
) -> Result<impl IntoResponse, WebError> {
    let header = headers.get("last-event-id").and_then(|id| id.to_str().ok());
    let received_until =
        query.last_event_id.as_deref().or(header).filter(|id| !id.is_empty()).map(event_time).transpose()?;
    let topics = parse_topics(query.topics.as_deref().unwrap_or(Topic::LIVE_STATE))?;
    // Without a socket, as in unit tests, no slots are shared.
    let slot = match streams {
        Some(Extension(streams)) => Some(streams.acquire().await?),
        None => None,
    };
    let keep_alive =
        KeepAlive::new().interval(HEARTBEAT_INTERVAL).event(Event::default().event("heartbeat").data(""));
    // Proxies that collect answers before they pass them on would make live figures late.
    let unbuffered = AppendHeaders([(HeaderName::from_static("x-accel-buffering"), "no")]);
    Ok((unbuffered, Sse::new(events(app, topics, received_until, slot)).keep_alive(keep_alive)))
}

/// Returns the time of the snapshot that an event was made of. The time is the event's id.
fn event_time(id: &str) -> Result<WallTime, WebError> {
    id.parse().map(WallTime::from_unix_nanos).map_err(|_| {
        WebError::BadRequest(format!("Last-Event-ID or last_event_id: {id:?} is not the id of an event"))
    })
}

/// Returns the number of latest seconds of each pipeline to send to a listener that has received everything up to `received_until`.
fn missed_seconds(received_until: WallTime, snapshot: &LiveState) -> usize {
    let missed_s = (snapshot.at - received_until).seconds().ceil();
    // An id from the future was made by another clock, so nothing is known about the missed time.
    let missed = if (0.0..MAX_HISTORY_SECONDS as f64).contains(&missed_s) {
        missed_s as usize
    } else {
        MAX_HISTORY_SECONDS
    };
    let requested = missed + PipelineList::SECONDS;
    if requested * snapshot.pipelines.len() > MAX_CATCH_UP_SECONDS {
        PipelineList::SECONDS
    } else {
        requested.min(MAX_HISTORY_SECONDS)
    }
}

/// Returns the topics of a list, each once.
fn parse_topics(text: &str) -> Result<Vec<Topic>, WebError> {
    let mut topics = Vec::new();
    for topic in text.split(',').filter(|topic| !topic.is_empty()) {
        let topic = Topic::parse(topic)?;
        if topics.contains(&topic) {
            continue;
        }
        if topics.len() == MAX_TOPICS {
            return Err(WebError::BadRequest(format!(
                "query parameter topics: give at most {MAX_TOPICS} different topics"
            )));
        }
        topics.push(topic);
    }
    Ok(topics)
}

/// State of one open stream.
struct Listener {
    app: App,
    topics: Vec<Topic>,
    live_states: watch::Receiver<Arc<LiveState>>,
    ready: watch::Receiver<Readiness>,
    /// Earliest time of the next events.
    next_send: Instant,
    /// Time of the last event that the listener received on an earlier stream; `None` once events were sent on this stream.
    received_until: Option<WallTime>,
    /// Hash of the HTML last sent, by index of the topic and part of its page.
    sent_hashes: HashMap<(usize, &'static str), u64>,
    /// Slot of the stream; released when the stream ends.
    _slot: Option<Slot>,
}

fn events(
    app: App,
    topics: Vec<Topic>,
    received_until: Option<WallTime>,
    slot: Option<Slot>,
) -> impl Stream<Item = Result<Event, Infallible>> {
    let mut live_states = app.aggregator.live();
    // The first snapshot is sent without waiting for a change.
    live_states.mark_changed();
    let stop = app.stop.clone();
    let ready = app.aggregator.readiness();
    let sent_hashes = HashMap::new();
    let listener = Listener {
        app,
        topics,
        live_states,
        ready,
        next_send: Instant::now(),
        received_until,
        sent_hashes,
        _slot: slot,
    };
    let batches = stream::unfold(listener, |mut listener| async move {
        tokio::time::sleep_until(listener.next_send).await;
        tokio::select! {
            changed = listener.live_states.changed() => changed.ok()?,
            changed = listener.ready.changed() => changed.ok()?,
        }
        let now = Instant::now();
        let snapshot = Arc::clone(&listener.live_states.borrow_and_update());
        let (events, bytes) = listener.events(&snapshot).await;
        listener.next_send = now + interval_after(bytes);
        Some((stream::iter(events.into_iter().map(Ok)), listener))
    });
    batches.flatten().take_until(stop.cancelled_owned())
}

/// Returns the time to wait after events of `bytes` bytes.
fn interval_after(bytes: usize) -> Duration {
    MIN_INTERVAL.max(Duration::from_secs_f64(bytes as f64 / MAX_BYTES_PER_SECOND as f64))
}

fn hash(text: &str) -> u64 {
    let mut hasher = DefaultHasher::new();
    text.hash(&mut hasher);
    hasher.finish()
}

impl Listener {
    /// Returns the events to send for a snapshot, and their size in bytes.
    async fn events(&mut self, snapshot: &LiveState) -> (Vec<Event>, usize) {
        let seconds = self
            .received_until
            .take()
            .map_or(PipelineList::SECONDS, |received_until| missed_seconds(received_until, snapshot));
        let readiness = self.ready.borrow_and_update().clone();
        let mut texts = vec![("status", serde_json::to_string(&StatusEvent::new(snapshot, &readiness)))];
        for (index, topic) in self.topics.iter().enumerate() {
            let Topic::Page(page) = topic else {
                texts.push((
                    Topic::LIVE_STATE,
                    serde_json::to_string(&LiveStateEvent::new(snapshot, seconds)),
                ));
                continue;
            };
            match page.update(&self.app, snapshot).await {
                Ok(mut update) => {
                    // A chart changes once a second, and numbers change up to four times a second. Unchanged parts are not sent again.
                    update.parts.retain(|(id, html)| {
                        // Only the hash is kept, so that a listener does not hold a copy of its page.
                        let hash = hash(html);
                        self.sent_hashes.insert((index, *id), hash) != Some(hash)
                    });
                    texts.push(("page", serde_json::to_string(&update)));
                }
                // The subject of the page was removed: the page keeps its contents, and `status` events continue.
                Err(WebError::NotFound(_)) => {}
                // `to_problem` logs the error. The problem itself is not sent, and the stream continues.
                Err(error) => {
                    error.to_problem(&self.app);
                }
            }
        }
        let texts: Vec<(&str, String)> = texts
            .into_iter()
            .filter_map(|(name, text)| {
                let text =
                    text.inspect_err(|error| tracing::error!(%error, "an event has no JSON form")).ok()?;
                Some((name, text))
            })
            .collect();
        let bytes = texts.iter().map(|(_, text)| text.len()).sum();
        let mut events: Vec<Event> =
            texts.into_iter().map(|(name, text)| Event::default().event(name).data(text)).collect();
        // Only the last event has the id. A listener that has received it has received all events of this snapshot.
        if let Some(last) = events.pop() {
            events.push(last.id(snapshot.at.unix_nanos().to_string()));
        }
        (events, bytes)
    }
}

#[cfg(test)]
mod tests {
    use peernet_clock::{Span, Verdict};

    use super::*;
    use crate::tests::samples;

    #[test]
    fn large_snapshots_are_sent_less_often() {
        assert_eq!(interval_after(20_000), MIN_INTERVAL);
        assert_eq!(interval_after(2 * MAX_BYTES_PER_SECOND), Duration::from_secs(2));
    }

    #[test]
    fn reconnected_listener_gets_missed_seconds() {
        let pipelines = |count: usize| {
            let pipeline = |at| samples::pipeline(&format!("line-{at}"), 30.0, 1.0, Verdict::Ok, &[]);
            samples::snapshot(vec![samples::host("cam-1", "Orin")], (0..count).map(pipeline).collect())
        };
        let snapshot = pipelines(4);
        let ago = |seconds| missed_seconds(snapshot.at - Span::from_seconds(seconds), &snapshot);
        assert_eq!([ago(0), ago(30), ago(590), ago(3_600)], [5, 35, 595, 600]);
        assert_eq!(ago(-60), 600, "an id of another clock");
        let many = pipelines(200);
        assert_eq!(missed_seconds(many.at - Span::from_seconds(30), &many), 35);
        assert_eq!(missed_seconds(many.at - Span::from_seconds(60), &many), 5, "more than is sent at once");
    }

    #[test]
    fn repeated_topic_is_sent_once() {
        let repeated_topics = ["picture", "overview"].repeat(5_000).join(",");
        let overview = pages::topic("overview").map(Topic::Page).expect("a page's topic");
        assert_eq!(parse_topics(&repeated_topics).expect("known"), [Topic::LiveState, overview]);
        assert_eq!(parse_topics("").expect("none"), []);
        let hosts: Vec<String> = (0..=MAX_TOPICS).map(|index| format!("host/{index}")).collect();
        assert!(parse_topics(&hosts[1..].join(",")).is_ok());
        assert!(parse_topics(&hosts.join(",")).expect_err("too many").to_string().contains("at most 16"));
    }
}
