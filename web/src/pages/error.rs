//! Error page.

use askama::Template;

use super::shell::Shell;
use crate::error::ProblemDetails;
use crate::state::AppState;

#[derive(Template)]
#[template(path = "pages/error.html")]
struct ErrorPage<'a> {
    shell: Shell,
    problem: &'a ProblemDetails,
}

/// Returns the page of a problem. Returns the text of the problem alone if the page cannot be rendered.
pub(crate) fn render(app: &AppState, problem: &ProblemDetails) -> String {
    let no_section = "";
    let shell = Shell::new(app, &app.live_state(), no_section, problem.title());
    ErrorPage { shell, problem }.render().unwrap_or_else(|_| problem.detail().to_owned())
}
