//! Registration of a page: its routes, its entry in the navigation, its topic of the live stream.

use std::fmt;

use axum::Router;
use futures::future::BoxFuture;
use peernet_aggregator::LiveState;

use super::Update;
use crate::error::WebError;
use crate::state::{App, AppState};

/// Registration of a page. The file of each page defines one `PageRegistration`, and the list in `pages/mod.rs` contains it.
pub(crate) struct PageRegistration {
    /// Routes of the page.
    pub routes: fn() -> Router<App>,
    /// Entry in the navigation; `None` for a page that belongs to the entry of another page.
    pub entry: Option<NavigationEntry>,
    /// Topic that updates the page while it is open; `None` for a page without live updates.
    pub topic: Option<LiveTopic>,
}

/// An entry of the navigation.
pub(crate) struct NavigationEntry {
    pub name: &'static str,
    /// Address of the page. The addresses of the pages below this page begin with this address.
    pub address: &'static str,
    /// Key that opens the page if it is pressed after `g`.
    pub key: &'static str,
}

/// The updates of a page on the live stream.
pub(crate) struct LiveTopic {
    /// Pattern of the topic: `hosts`, or `host/HOST` if the text after the first slash identifies the page.
    pub pattern: &'static str,
    /// Renders the live parts of the page, from a snapshot and the text after the first slash of the topic.
    pub update: for<'a> fn(&'a AppState, &'a LiveState, &'a str) -> UpdateFuture<'a>,
}

pub(crate) type UpdateFuture<'a> = BoxFuture<'a, Result<Update, WebError>>;

/// A topic that a client requested: its registration, and the text that identifies the page.
#[derive(Clone)]
pub(crate) struct RequestedTopic {
    topic: &'static LiveTopic,
    /// Text after the first slash of the requested topic, such as `cam-1`; empty without a slash.
    rest: String,
}

impl RequestedTopic {
    /// Finds the topic of a text, such as `host/cam-1`, among `topics`.
    pub(crate) fn find(text: &str, mut topics: impl Iterator<Item = &'static LiveTopic>) -> Option<Self> {
        let (name, rest) = split_topic(text);
        let matches = |topic: &&LiveTopic| {
            let (topic_name, pattern_rest) = split_topic(topic.pattern);
            topic_name == name && pattern_rest.is_some() == rest.is_some()
        };
        topics.find(matches).map(|topic| Self { topic, rest: rest.unwrap_or_default().to_owned() })
    }

    /// Renders the live parts of the page.
    pub(crate) async fn update(&self, app: &AppState, snapshot: &LiveState) -> Result<Update, WebError> {
        (self.topic.update)(app, snapshot, &self.rest).await
    }
}

/// Splits the text of a topic into its name, and the text after its first slash; `None` without a slash.
fn split_topic(text: &str) -> (&str, Option<&str>) {
    text.split_once('/').map_or((text, None), |(name, rest)| (name, Some(rest)))
}

impl PartialEq for RequestedTopic {
    fn eq(&self, other: &Self) -> bool {
        (self.topic.pattern, &self.rest) == (other.topic.pattern, &other.rest)
    }
}

impl fmt::Debug for RequestedTopic {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} of {:?}", self.topic.pattern, self.rest)
    }
}
