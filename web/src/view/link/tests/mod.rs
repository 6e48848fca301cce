//! Tests of a link's page.

mod chart;
mod delays;
mod finding;
mod names;
mod origin;
mod panels;
mod time_series;

use super::time_series::LinkTimeSeries;
use super::{LinkSnapshot, Subject};

fn time_series(link: &LinkSnapshot) -> LinkTimeSeries {
    LinkTimeSeries::live(&link.history, Subject::live(link).end, 600)
}
