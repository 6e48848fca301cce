//! How a host fares, now and for the last ten minutes.

use std::collections::VecDeque;
use std::sync::Arc;

use peernet_clock::{MonoTime, Span, Stamp};
use peernet_stream::HostMetrics;

use crate::picture::MetricsPoint;

/// Distance of the points.
const POINT_EVERY: Span = Span::from_seconds(5);
/// Number of points: ten minutes.
const POINTS: usize = 120;

/// The last metrics of a host and earlier ones at fixed distances.
#[derive(Debug)]
pub(super) struct MetricsHistory {
    current: HostMetrics,
    points: VecDeque<Arc<MetricsPoint>>,
    next_point: MonoTime,
}

impl MetricsHistory {
    pub(super) fn new(now: MonoTime) -> Self {
        Self { current: HostMetrics::default(), points: VecDeque::new(), next_point: now }
    }

    /// Takes in what the host tells now.
    pub(super) fn push(&mut self, metrics: HostMetrics, now: Stamp) {
        if now.mono >= self.next_point {
            self.next_point = now.mono + POINT_EVERY;
            if self.points.len() == POINTS {
                self.points.pop_front();
            }
            self.points.push_back(Arc::new(MetricsPoint { at: now.wall, metrics: metrics.clone() }));
        }
        self.current = metrics;
    }

    pub(super) const fn current(&self) -> &HostMetrics {
        &self.current
    }

    /// The points, oldest first.
    pub(super) fn points(&self) -> Vec<Arc<MetricsPoint>> {
        self.points.iter().cloned().collect()
    }
}
