//! `GET /api/v1/live`: one stream of events per page.
//!
//! Each listener draws from the newest picture when it is ready for it, at most four times a second, so a slow
//! one skips pictures and never makes the others wait.

use std::convert::Infallible;
use std::sync::Arc;
use std::time::Duration;

use axum::extract::State;
use axum::http::HeaderName;
use axum::response::sse::{Event, KeepAlive, Sse};
use axum::response::{AppendHeaders, IntoResponse};
use futures::{Stream, StreamExt, stream};
use peernet_aggregator::Picture;
use serde::Deserialize;
use tokio::sync::watch;
use tokio::time::Instant;
use utoipa::IntoParams;

use super::parameters::Parameters;
use super::schema::{PictureEvent, StatusEvent};
use crate::error::{ProblemDetails, WebError};
use crate::pages::{Update, host, hosts, overview, pipeline, pipelines};
use crate::state::{App, AppState};

/// Time between two pictures.
const PAUSE: Duration = Duration::from_millis(250);
/// Time between two signs of life while nothing changes.
const HEARTBEAT: Duration = Duration::from_secs(2);

/// What to listen to.
#[derive(Clone, Debug, Default, Deserialize, IntoParams)]
#[serde(deny_unknown_fields, default)]
#[into_params(parameter_in = Query)]
pub(crate) struct Query {
    /// Topics, parted by commas: `picture` (all pipelines and hosts as JSON), and for the dashboard `overview`,
    /// `pipelines`, `hosts`, `pipeline/HOST/PIPELINE/SECONDS`, `host/HOST`. `picture` unless given.
    topics: Option<String>,
}

#[derive(Clone, Debug, PartialEq, Eq)]
enum Topic {
    Picture,
    Overview,
    Pipelines,
    Hosts,
    Pipeline(String),
    Host(String),
}

impl Topic {
    fn parse(text: &str) -> Result<Self, WebError> {
        match text.split_once('/') {
            None if text == "picture" => Ok(Self::Picture),
            None if text == overview::TOPIC => Ok(Self::Overview),
            None if text == pipelines::TOPIC => Ok(Self::Pipelines),
            None if text == hosts::TOPIC => Ok(Self::Hosts),
            Some((topic, rest)) if topic == pipeline::TOPIC => Ok(Self::Pipeline(rest.to_owned())),
            Some((topic, rest)) if topic == host::TOPIC => Ok(Self::Host(rest.to_owned())),
            _ => Err(WebError::BadRequest(format!(
                "query parameter topics: {text:?} is none of picture, overview, pipelines, hosts, \
                 pipeline/HOST/PIPELINE/SECONDS, host/HOST"
            ))),
        }
    }

    async fn update(&self, app: &AppState, picture: &Picture) -> Option<Result<Update, WebError>> {
        Some(match self {
            Self::Picture => return None,
            Self::Overview => overview::update(app, picture).await,
            Self::Pipelines => pipelines::update(app, picture),
            Self::Hosts => hosts::update(app, picture),
            Self::Pipeline(rest) => pipeline::update(app, picture, rest),
            Self::Host(name) => host::update(app, picture, name),
        })
    }
}

/// Live figures as server-sent events: `status` always, `picture` and `page` by topic. At most four of each a
/// second; a listener that cannot follow gets the newest and misses those between.
#[utoipa::path(get, path = "/api/v1/live", tag = "pipelines", params(Query), responses(
    (status = 200, description = "`event: status` (StatusEvent), `event: picture` (PictureEvent), `event: page`, `event: heartbeat`", body = String, content_type = "text/event-stream"),
    (status = "default", body = ProblemDetails, content_type = "application/problem+json"),
))]
pub(crate) async fn stream(
    State(app): State<App>,
    Parameters(query): Parameters<Query>,
) -> Result<impl IntoResponse, WebError> {
    let topics = query.topics.as_deref().unwrap_or("picture");
    let topics = topics
        .split(',')
        .filter(|topic| !topic.is_empty())
        .map(Topic::parse)
        .collect::<Result<Vec<_>, _>>()?;
    let keep_alive = KeepAlive::new().interval(HEARTBEAT).event(Event::default().event("heartbeat").data(""));
    // Proxies that collect answers before they pass them on would make live figures late.
    let unbuffered = AppendHeaders([(HeaderName::from_static("x-accel-buffering"), "no")]);
    Ok((unbuffered, Sse::new(events(app, topics)).keep_alive(keep_alive)))
}

struct Listener {
    app: App,
    topics: Vec<Topic>,
    pictures: watch::Receiver<Arc<Picture>>,
    next: Instant,
}

fn events(app: App, topics: Vec<Topic>) -> impl Stream<Item = Result<Event, Infallible>> {
    let mut pictures = app.aggregator.live();
    // The first picture goes out at once.
    pictures.mark_changed();
    let stop = app.stop.clone();
    let listener = Listener { app, topics, pictures, next: Instant::now() };
    let batches = stream::unfold(listener, |mut listener| async move {
        tokio::time::sleep_until(listener.next).await;
        listener.pictures.changed().await.ok()?;
        listener.next = Instant::now() + PAUSE;
        let picture = Arc::clone(&listener.pictures.borrow_and_update());
        let events = listener.events(&picture).await;
        Some((stream::iter(events.into_iter().map(Ok)), listener))
    });
    batches.flatten().take_until(stop.cancelled_owned())
}

impl Listener {
    async fn events(&self, picture: &Picture) -> Vec<Event> {
        let mut events = vec![Event::default().event("status").json_data(StatusEvent::new(picture))];
        for topic in &self.topics {
            match topic.update(&self.app, picture).await {
                None => events.push(Event::default().event("picture").json_data(PictureEvent::new(picture))),
                Some(Ok(update)) => events.push(Event::default().event("page").json_data(update)),
                // What the page is about went away: it keeps what it shows, `status` goes on.
                Some(Err(WebError::NotFound(_))) => {}
                Some(Err(error)) => {
                    error.to_problem();
                }
            }
        }
        events
            .into_iter()
            .filter_map(|event| {
                event.inspect_err(|error| tracing::error!(%error, "an event has no JSON form")).ok()
            })
            .collect()
    }
}
