//! What surrounds every page.

use peernet_aggregator::Picture;

use super::rehearsal::Rehearsed;
use super::storing;
use crate::assets;
use crate::state::AppState;

/// A page of the navigation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Place {
    Overview,
    Pipelines,
    Runs,
    Compare,
    Links,
    Hosts,
    Incidents,
    /// A page that belongs to none of them.
    Elsewhere,
}

impl Place {
    /// The entries of the navigation: place, name, address, key after `g`.
    pub(crate) const NAVIGATION: [(Self, &'static str, &'static str, &'static str); 7] = [
        (Self::Overview, "Overview", "/", "o"),
        (Self::Pipelines, "Pipelines", "/pipelines", "p"),
        (Self::Runs, "Runs", "/runs", "r"),
        (Self::Compare, "Compare", "/compare", "c"),
        (Self::Links, "Links", "/links", "l"),
        (Self::Hosts, "Hosts", "/hosts", "h"),
        (Self::Incidents, "Incidents", "/incidents", "i"),
    ];
}

/// Head, top bar and foot of a page.
#[derive(Clone, Debug)]
pub(crate) struct Shell {
    /// Which entry of the navigation is marked.
    pub place: Place,
    /// Title of the window.
    pub title: String,
    /// Folder of the static files.
    pub statics: String,
    /// Name of the zone of all times.
    pub zone: String,
    /// Seconds east of UTC, for the scripts.
    pub offset: i32,
    /// Name of the aggregator.
    pub aggregator: String,
    /// Topic whose live updates change this page, if any.
    pub topic: Option<String>,
    /// Whether any host ever reported.
    pub waiting: bool,
    /// What is said about clocks that are made wrong on purpose.
    pub rehearsals: Vec<String>,
    /// Said while events are not being stored.
    pub not_storing: Option<String>,
}

impl Shell {
    /// Version of the program.
    pub(crate) const VERSION: &'static str = env!("CARGO_PKG_VERSION");

    /// The shell of a page that live updates do not change.
    pub(crate) fn new(app: &AppState, picture: &Picture, place: Place, title: impl Into<String>) -> Self {
        let now = app.clock.wall();
        Self {
            place,
            title: title.into(),
            statics: assets::folder(),
            zone: app.zone.name(now),
            offset: app.zone.offset_seconds(now),
            aggregator: picture.aggregator.to_string(),
            topic: None,
            waiting: picture.hosts.is_empty(),
            rehearsals: Rehearsed::of(picture).banner(),
            not_storing: storing::notice(&app.aggregator.ready()),
        }
    }

    /// The same for a page that follows a topic of the live stream.
    pub(crate) fn live(mut self, topic: impl Into<String>) -> Self {
        self.topic = Some(topic.into());
        self
    }
}
