//! Views that several pages share.

pub(crate) mod accuracy;
pub(crate) mod bytes;
pub(crate) mod chart;
pub(crate) mod chip;
pub(crate) mod clock_fault;
pub(crate) mod clocks;
pub(crate) mod compare;
pub(crate) mod data;
pub(crate) mod episodes;
pub(crate) mod events;
pub(crate) mod health;
pub(crate) mod histogram;
pub(crate) mod hosts;
pub(crate) mod incidents;
pub(crate) mod link;
pub(crate) mod list_limits;
pub(crate) mod notes;
pub(crate) mod now;
pub(crate) mod place;
pub(crate) mod run;
pub(crate) mod runs;
pub(crate) mod speed;
pub(crate) mod stack;
pub(crate) mod stages;
pub(crate) mod startup;
pub(crate) mod storing;
pub(crate) mod trust;
pub(crate) mod units;
pub(crate) mod warnings;
pub(crate) mod waterfall;

/// Returns `1 link`, `3 links`.
pub(crate) fn counted(count: usize, singular: &str, plural: &str) -> String {
    format!(
        "{} {}",
        peernet_statistics::number::count(count as u64),
        if count == 1 { singular } else { plural }
    )
}
