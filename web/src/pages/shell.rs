//! The frame of every page: head, top bar and foot.

use peernet_aggregator::LiveState;

use super::registration::NavigationEntry;
use crate::assets;
use crate::state::AppState;
use crate::view::clock_fault::FaultyClocks;
use crate::view::storage_notice;

/// Head, top bar and foot of a page.
#[derive(Clone, Debug)]
pub(crate) struct Shell {
    /// Address of the navigation entry that is marked; empty for a page that belongs to no entry.
    pub section: &'static str,
    /// Title of the browser's window.
    pub title: String,
    /// Folder of the static files.
    pub statics: String,
    /// Name of the zone of all times.
    pub zone: String,
    /// Offset of the zone from UTC in seconds east, for the scripts.
    pub offset: i32,
    /// Name of the aggregator.
    pub aggregator: String,
    /// Topic of the live stream that updates this page; `None` for a page without live updates.
    pub topic: Option<String>,
    /// `true` if no host has reported yet.
    pub is_waiting: bool,
    /// Sentences about injected clock faults, one per host.
    pub clock_faults: Vec<String>,
    /// Sentence shown while events are not being stored.
    pub not_storing: Option<String>,
}

impl Shell {
    /// Version of the program.
    pub(crate) const VERSION: &'static str = env!("CARGO_PKG_VERSION");

    /// Returns the entries of the navigation.
    pub(crate) fn navigation() -> impl Iterator<Item = &'static NavigationEntry> {
        super::navigation_entries()
    }

    /// Returns the shell of a page that live updates do not change.
    pub(crate) fn new(
        app: &AppState,
        snapshot: &LiveState,
        section: &'static str,
        title: impl Into<String>,
    ) -> Self {
        debug_assert!(
            section.is_empty() || Self::navigation().any(|entry| entry.address == section),
            "{section} is not an entry of the navigation"
        );
        let now = app.clock.wall();
        Self {
            section,
            title: title.into(),
            statics: assets::base_path(),
            zone: app.zone.name(now),
            offset: app.zone.offset_seconds(now),
            aggregator: snapshot.aggregator.to_string(),
            topic: None,
            is_waiting: snapshot.hosts.is_empty(),
            clock_faults: FaultyClocks::of(snapshot).banner(),
            not_storing: storage_notice::notice(&app.aggregator.current_readiness()),
        }
    }

    /// Returns the shell of a page that a topic of the live stream updates.
    pub(crate) fn live(mut self, topic: impl Into<String>) -> Self {
        self.topic = Some(topic.into());
        self
    }
}
