//! Tests of a link's page.

mod chart;
mod course;
mod delays;
mod finding;
mod names;
mod origin;
mod panels;

use super::course::Course;
use super::{LinkSnapshot, Subject};

fn course(link: &LinkSnapshot) -> Course {
    Course::live(&link.history, Subject::live(link).end, 600)
}
