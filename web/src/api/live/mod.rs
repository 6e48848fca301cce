//! `GET /api/v1/live`: one stream of events per page.
//!
//! Each listener takes the newest picture when it is ready for it, at most four times a second, less often when pictures are large. A
//! slow listener therefore skips pictures and never delays the others.

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

use self::schema::{PictureEvent, StatusEvent};
use crate::api::schema::PipelineList;
use crate::connections::Streams;
use crate::error::{ProblemDetails, WebError};
use crate::fair_places::Place;
use crate::pages::{self, PageTopic};
use crate::parameters::Parameters;
use crate::state::App;

/// Returns the operations of this resource.
pub(super) fn routes() -> OpenApiRouter<App> {
    let mut router = OpenApiRouter::with_openapi(Events::openapi()).routes(routes!(stream));
    describe_topics(router.get_openapi_mut());
    router
}

/// Describes the parameter `topics` by the topics that the pages registered.
fn describe_topics(document: &mut utoipa::openapi::OpenApi) {
    let forms: Vec<String> = pages::topic_forms().map(|form| format!("`{form}`")).collect();
    // The first line ends where it always did, because the committed document shows it.
    let (first, others) = forms.split_at(1);
    let text = format!(
        "Topics, parted by commas: `picture` (all pipelines and hosts as JSON), and for the dashboard {},\n{}.\n\
         `picture` unless given; at most {TOPICS} different ones, each sent once however often it is named.",
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
#[openapi(components(schemas(PictureEvent, StatusEvent)))]
struct Events;

/// Time between two pictures.
const PAUSE: Duration = Duration::from_millis(250);
/// Largest average number of bytes per second to one listener. Large pictures are sent less often.
const RATE: usize = 512 << 10;
/// Largest number of different topics on one stream. A page needs one.
const TOPICS: usize = 16;
/// Largest number of seconds of each pipeline sent to a listener that reconnects.
const HISTORY: usize = 600;
/// Largest number of seconds of all pipelines together in one event. A listener that needs more requests each pipeline separately.
const CATCH_UP: usize = 10_000;
/// Time between two heartbeats while nothing changes.
const HEARTBEAT: Duration = Duration::from_secs(2);

/// Query parameters of the live stream.
#[derive(Clone, Debug, Default, Deserialize, IntoParams)]
#[serde(deny_unknown_fields, default)]
#[into_params(parameter_in = Query)]
struct Query {
    // `describe_topics` describes this parameter, because the pages define the topics.
    topics: Option<String>,
    /// Id of the last event of an earlier stream, as the header `Last-Event-ID`, which an `EventSource` cannot set: the first `picture`
    /// then holds the seconds since, at most 600. All other parts are sent as they are now.
    #[param(pattern = "^-?[0-9]+$")]
    last_event_id: Option<String>,
}

/// Subject of the events that a listener receives.
#[derive(Clone, Debug, PartialEq)]
enum Topic {
    Picture,
    Page(PageTopic),
}

impl Topic {
    /// The topic of the picture itself.
    const PICTURE: &str = "picture";

    fn parse(text: &str) -> Result<Self, WebError> {
        if text == Self::PICTURE {
            return Ok(Self::Picture);
        }
        pages::topic(text).map(Self::Page).ok_or_else(|| {
            let known: Vec<&str> = [Self::PICTURE].into_iter().chain(pages::topic_forms()).collect();
            WebError::BadRequest(format!("query parameter topics: {text:?} is none of {}", known.join(", ")))
        })
    }
}

/// Live figures as server-sent events: `status` always, `picture` and `page` by topic. At most four of each are sent a second, fewer
/// where they make more than 512 KiB a second. A listener that is too slow receives the newest events and misses those between. At most
/// 32 streams of one address are open, and in all a quarter of the server's connections; further ones are answered with 503.
#[utoipa::path(get, path = "/api/v1/live", operation_id = "streamLive", tag = "pipelines", params(Query), responses(
    (status = 200, description = "`event: status` (StatusEvent), `event: picture` (PictureEvent), `event: page`, `event: heartbeat`", body = String, content_type = "text/event-stream"),
    (status = "default", body = ProblemDetails, content_type = "application/problem+json"),
))]
async fn stream(
    State(app): State<App>,
    streams: Option<Extension<Streams>>,
    headers: HeaderMap,
    Parameters(query): Parameters<Query>,
) -> Result<impl IntoResponse, WebError> {
    let header = headers.get("last-event-id").and_then(|id| id.to_str().ok());
    let after =
        query.last_event_id.as_deref().or(header).filter(|id| !id.is_empty()).map(event_time).transpose()?;
    let topics = topics(query.topics.as_deref().unwrap_or("picture"))?;
    // Without a socket, as in unit tests, there are no places to share.
    let place = match streams {
        Some(Extension(streams)) => Some(streams.take().await?),
        None => None,
    };
    let keep_alive = KeepAlive::new().interval(HEARTBEAT).event(Event::default().event("heartbeat").data(""));
    // Proxies that collect answers before they pass them on would make live figures late.
    let unbuffered = AppendHeaders([(HeaderName::from_static("x-accel-buffering"), "no")]);
    Ok((unbuffered, Sse::new(events(app, topics, after, place)).keep_alive(keep_alive)))
}

/// Returns the time of the picture that an event was made of, by the event's id.
fn event_time(id: &str) -> Result<WallTime, WebError> {
    id.parse().map(WallTime::from_unix_nanos).map_err(|_| {
        WebError::BadRequest(format!("query parameter last_event_id: {id:?} is not the id of an event"))
    })
}

/// Returns how many last seconds of each pipeline to send to a listener that has received everything up to `after`.
fn seconds_since(after: WallTime, picture: &LiveState) -> usize {
    let missed = (picture.at - after).seconds().ceil();
    // An id from the future comes from another clock: all seconds are sent.
    let missed = if (0.0..HISTORY as f64).contains(&missed) { missed as usize } else { HISTORY };
    let wanted = missed + PipelineList::SECONDS;
    if wanted * picture.pipelines.len() > CATCH_UP { PipelineList::SECONDS } else { wanted.min(HISTORY) }
}

/// Returns the topics of a list, each once.
fn topics(text: &str) -> Result<Vec<Topic>, WebError> {
    let mut topics = Vec::new();
    for topic in text.split(',').filter(|topic| !topic.is_empty()) {
        let topic = Topic::parse(topic)?;
        if topics.contains(&topic) {
            continue;
        }
        if topics.len() == TOPICS {
            return Err(WebError::BadRequest(format!(
                "query parameter topics: give at most {TOPICS} different ones"
            )));
        }
        topics.push(topic);
    }
    Ok(topics)
}

struct Listener {
    app: App,
    topics: Vec<Topic>,
    pictures: watch::Receiver<Arc<LiveState>>,
    ready: watch::Receiver<Readiness>,
    next: Instant,
    /// Time up to which the listener has received all events, before the first event.
    after: Option<WallTime>,
    /// Version last sent, by index of the topic and part of its page.
    sent: HashMap<(usize, &'static str), u64>,
    /// Held for as long as the stream is open.
    _place: Option<Place>,
}

fn events(
    app: App,
    topics: Vec<Topic>,
    after: Option<WallTime>,
    place: Option<Place>,
) -> impl Stream<Item = Result<Event, Infallible>> {
    let mut pictures = app.aggregator.live();
    // The first picture is sent without waiting for a change.
    pictures.mark_changed();
    let stop = app.stop.clone();
    let ready = app.aggregator.readiness();
    let sent = HashMap::new();
    let listener =
        Listener { app, topics, pictures, ready, next: Instant::now(), after, sent, _place: place };
    let batches = stream::unfold(listener, |mut listener| async move {
        tokio::time::sleep_until(listener.next).await;
        tokio::select! {
            changed = listener.pictures.changed() => changed.ok()?,
            changed = listener.ready.changed() => changed.ok()?,
        }
        let now = Instant::now();
        let picture = Arc::clone(&listener.pictures.borrow_and_update());
        let (events, bytes) = listener.events(&picture).await;
        listener.next = now + pause(bytes);
        Some((stream::iter(events.into_iter().map(Ok)), listener))
    });
    batches.flatten().take_until(stop.cancelled_owned())
}

/// Returns the time to wait after events of `bytes` bytes.
fn pause(bytes: usize) -> Duration {
    PAUSE.max(Duration::from_secs_f64(bytes as f64 / RATE as f64))
}

fn hash(text: &str) -> u64 {
    let mut hasher = DefaultHasher::new();
    text.hash(&mut hasher);
    hasher.finish()
}

impl Listener {
    /// Returns the events to send of a picture, and their size in bytes.
    async fn events(&mut self, picture: &LiveState) -> (Vec<Event>, usize) {
        let seconds = self.after.take().map_or(PipelineList::SECONDS, |after| seconds_since(after, picture));
        let readiness = self.ready.borrow_and_update().clone();
        let mut texts = vec![("status", serde_json::to_string(&StatusEvent::new(picture, &readiness)))];
        for (index, topic) in self.topics.iter().enumerate() {
            let Topic::Page(page) = topic else {
                texts.push(("picture", serde_json::to_string(&PictureEvent::new(picture, seconds))));
                continue;
            };
            match page.update(&self.app, picture).await {
                Ok(mut update) => {
                    // A chart changes once a second, figures up to four times: unchanged parts are not sent again.
                    update.parts.retain(|(id, html)| {
                        let hash = hash(html);
                        self.sent.insert((index, *id), hash) != Some(hash)
                    });
                    texts.push(("page", serde_json::to_string(&update)));
                }
                // The subject of the page was removed: the page keeps its contents, and `status` events continue.
                Err(WebError::NotFound(_)) => {}
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
        // The id stands on the last event only: a listener that has received it has received all of them.
        if let Some(last) = events.pop() {
            events.push(last.id(picture.at.unix_nanos().to_string()));
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
    fn large_pictures_come_less_often() {
        assert_eq!(pause(20_000), PAUSE);
        assert_eq!(pause(2 * RATE), Duration::from_secs(2));
    }

    #[test]
    fn listener_gets_the_seconds_it_missed() {
        let lines = |count: usize| {
            let line = |at| samples::pipeline(&format!("line-{at}"), 30.0, 1.0, Verdict::Ok, &[]);
            samples::picture(vec![samples::host("cam-1", "Orin")], (0..count).map(line).collect())
        };
        let picture = lines(4);
        let ago = |seconds| seconds_since(picture.at - Span::from_seconds(seconds), &picture);
        assert_eq!([ago(0), ago(30), ago(590), ago(3_600)], [5, 35, 595, 600]);
        assert_eq!(ago(-60), 600, "an id of another clock");
        let crowd = lines(200);
        assert_eq!(seconds_since(crowd.at - Span::from_seconds(30), &crowd), 35);
        assert_eq!(seconds_since(crowd.at - Span::from_seconds(60), &crowd), 5, "more than is sent at once");
    }

    #[test]
    fn a_topic_named_often_is_sent_once() {
        let often = ["picture", "overview"].repeat(5_000).join(",");
        let overview = pages::topic("overview").map(Topic::Page).expect("a page's topic");
        assert_eq!(topics(&often).expect("known"), [Topic::Picture, overview]);
        assert_eq!(topics("").expect("none"), []);
        let hosts: Vec<String> = (0..=TOPICS).map(|index| format!("host/{index}")).collect();
        assert!(topics(&hosts[1..].join(",")).is_ok());
        assert!(topics(&hosts.join(",")).expect_err("too many").to_string().contains("at most 16"));
    }
}
