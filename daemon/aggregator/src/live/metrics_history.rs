//! The current load metrics of a host and their history of ten minutes.

use std::collections::VecDeque;
use std::sync::Arc;

use peernet_clock::{MonoTime, Span, Stamp};
use peernet_stream::HostMetrics;

use crate::live_state::MetricsPoint;

/// Interval between two points.
const POINT_INTERVAL: Span = Span::from_seconds(5);
/// Maximum number of points: ten minutes.
const MAX_POINTS: usize = 120;

/// The latest metrics of a host, and earlier metrics at a fixed interval.
#[derive(Debug)]
pub(super) struct MetricsHistory {
    current: HostMetrics,
    points: VecDeque<Arc<MetricsPoint>>,
    next_point: MonoTime,
}

impl MetricsHistory {
    /// Creates an empty history.
    pub(super) fn new(now: MonoTime) -> Self {
        Self { current: HostMetrics::default(), points: VecDeque::new(), next_point: now }
    }

    /// Adds the latest metrics.
    pub(super) fn push(&mut self, metrics: HostMetrics, now: Stamp) {
        if now.mono >= self.next_point {
            self.next_point = now.mono + POINT_INTERVAL;
            if self.points.len() == MAX_POINTS {
                self.points.pop_front();
            }
            self.points.push_back(Arc::new(MetricsPoint { at: now.wall, metrics: metrics.clone() }));
        }
        self.current = metrics;
    }

    /// Returns the latest metrics.
    pub(super) const fn current(&self) -> &HostMetrics {
        &self.current
    }

    /// Returns the points, oldest first.
    pub(super) fn points(&self) -> Vec<Arc<MetricsPoint>> {
        self.points.iter().cloned().collect()
    }
}
