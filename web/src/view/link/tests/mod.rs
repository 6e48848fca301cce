//! Tests of a link's page.

mod chart;
mod course;
mod delays;
mod finding;
mod names;
mod origin;
mod panels;

use super::course::Course;
use super::{LinkPicture, Subject};

fn course(link: &LinkPicture) -> Course {
    Course::live(&link.history, Subject::live(link).end, 600)
}
