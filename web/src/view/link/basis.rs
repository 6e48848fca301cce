//! Texts about the assumptions on which the bounds of one-way delays depend.

use peernet_clock::{DelaySource, RelatedClocks, Span};
use peernet_statistics::number::{SPACE, figure, fixed, long_duration};
use peernet_store::DelayAssumptions;

use super::Subject;
use super::panels::Pairs;
use super::stats::ppm;
use super::time_series::LinkTimeSeries;

/// Returns the related clocks as the subject of a sentence.
const fn clocks_subject(clocks: RelatedClocks) -> &'static str {
    match clocks {
        RelatedClocks::Raw => "the free-running clocks of both hosts",
        RelatedClocks::RawToWall => "the free-running clock of the edge and the wall clock of the cloud",
        RelatedClocks::Wall => "the wall clocks of both hosts",
    }
}

/// Returns a sentence with the conditions under which the intervals contain the true delays.
/// README.md and docs/clocks.md have the same sentence with default values; this sentence has the
/// values of a link.
pub(crate) fn promise(assumptions: &DelayAssumptions) -> String {
    let clocks = clocks_subject(assumptions.clocks);
    let drift = assumptions.max_drift_ppm.map_or_else(
        || "no faster than assumed".to_owned(),
        |drift| format!("by at most {}{SPACE}ppm", figure(drift)),
    );
    let mut conditions = vec![format!("{clocks} drift apart {drift}")];
    if let Some(change) = assumptions.max_drift_change_ppm_per_s {
        conditions.push(format!("this rate changes by at most {}{SPACE}ppm per second", figure(change)));
    }
    conditions.push("neither is stepped unnoticed".to_owned());
    // Stamps of probes can be forged by anyone on the path if the probes are not authenticated.
    let stamps = "no stamp is forged";
    conditions.push(match assumptions.probes_authenticated {
        Some(false) => format!("{stamps} (their probes are not authenticated)"),
        Some(true) | None => stamps.to_owned(),
    });
    if assumptions.claims_trusted == Some(true) {
        conditions.push("the trusted claims of time daemons are true".to_owned());
    }
    let last = conditions.pop().unwrap_or_default();
    format!("Each interval contains the true delay as long as {}, and {last}.", conditions.join(", "))
}

/// Returns the source of a delay in words.
pub(crate) const fn source_words(source: DelaySource) -> &'static str {
    match source {
        DelaySource::SameClock => "one clock",
        DelaySource::InBand => "in-band",
        DelaySource::Kernel => "as claimed by the kernels",
        DelaySource::Chrony => "as claimed by chrony",
        DelaySource::Intersection => "in-band, narrowed as claimed by time daemons",
        DelaySource::None => "none",
    }
}

/// Returns remarks that limit the trust in the bounds: claims that narrow the bounds, and probes without
/// authentication.
pub(crate) fn trust_remarks(subject: &Subject<'_>) -> Vec<String> {
    let mut remarks = Vec::new();
    if let Some(offset) = subject.offset().filter(|offset| offset.source.uses_claims()) {
        let has_chrony = offset.sources.iter().any(|(source, _)| *source == DelaySource::Chrony);
        remarks.push(format!("bounds as claimed by {}", if has_chrony { "chrony" } else { "the kernels" }));
    }
    if subject.assumptions.is_some_and(|assumptions| assumptions.probes_authenticated == Some(false)) {
        remarks.push("probes not authenticated".to_owned());
    }
    remarks
}

/// Returns the assumptions in a few words, for the row of a delay: `by free-running clocks, ρ 200 ppm, κ 1 ppm/s,
/// probes not authenticated`.
pub(crate) fn brief_words(assumptions: &DelayAssumptions) -> String {
    let by = format!("by {}", assumptions.clocks.words());
    let drift = assumptions.max_drift_ppm.map(|drift| format!("ρ {}{SPACE}ppm", figure(drift)));
    let change =
        assumptions.max_drift_change_ppm_per_s.map(|change| format!("κ {}{SPACE}ppm/s", figure(change)));
    let probes = match assumptions.probes_authenticated {
        Some(true) => Some("probes authenticated"),
        Some(false) => Some("probes not authenticated"),
        None => None,
    };
    let parts = [Some(by), drift, change, probes.map(str::to_owned)];
    parts.into_iter().flatten().collect::<Vec<_>>().join(", ")
}

/// Returns the panel about assumptions: the assumed limits, the drift that the exchanges prove, and
/// other information that narrows a bound. The panel is empty if both hosts read one clock.
pub(crate) fn pairs(subject: &Subject<'_>, time_series: &LinkTimeSeries) -> Pairs {
    let Some(assumptions) = &subject.assumptions else { return Pairs::new() };
    let newest = NewestBasis::of(subject, time_series);
    let clocks = match assumptions.clocks {
        RelatedClocks::Raw => {
            format!(
                "{} (CLOCK_MONOTONIC_RAW): no time daemon steps or slews them",
                clocks_subject(assumptions.clocks)
            )
        }
        clocks => format!("{}: a step or slew of a wall clock affects the delays", clocks_subject(clocks)),
    };
    let mut pairs: Pairs = vec![("Clocks related", clocks)];
    if let Some(drift) = assumptions.max_drift_ppm {
        pairs.push(("Assumed drift", format!("at most {}{SPACE}ppm (ρ)", figure(drift))));
    }
    let change = assumptions.max_drift_change_ppm_per_s.map_or_else(
        || "no limit: bounds at other times than an exchange depend on the assumed drift alone".to_owned(),
        |change| format!("at most {}{SPACE}ppm per second (κ)", figure(change)),
    );
    pairs.push(("Assumed change of drift", change));
    pairs.push(("Proven drift", describe_proven_drift(subject, assumptions, newest.proven_skew_ppm)));
    pairs.push(("Window", window_text(newest.oldest_exchange_age)));
    let claims = match assumptions.claims_trusted {
        Some(true) => {
            let source = subject.offset().map_or_else(
                || "no offset is known now".to_owned(),
                |offset| format!("source of the offset now: {}", source_words(offset.source)),
            );
            format!("trusted: they may narrow the bound; {source}")
        }
        Some(false) => "shown for comparison only".to_owned(),
        None => "not reported".to_owned(),
    };
    pairs.push(("Claims of time daemons", claims));
    let probes = match assumptions.probes_authenticated {
        Some(true) => "authenticated",
        Some(false) => "not authenticated: anyone on the network path can forge answers",
        None => "not reported, or no probes are sent",
    };
    pairs.push(("Probes", probes.to_owned()));
    pairs
}

/// Values of the newest clock sample of a link that follow from exchanges.
#[derive(Clone, Copy, Default)]
struct NewestBasis {
    proven_skew_ppm: Option<(f64, f64)>,
    oldest_exchange_age: Option<Span>,
}

impl NewestBasis {
    fn of(subject: &Subject<'_>, time_series: &LinkTimeSeries) -> Self {
        match (subject.live, time_series.points.last()) {
            (Some(link), _) => link.live.latest_sample.basis.map_or_else(Self::default, |basis| Self {
                proven_skew_ppm: basis.proven_skew_ppm,
                oldest_exchange_age: basis.oldest_exchange_age,
            }),
            (None, Some(point)) => Self {
                proven_skew_ppm: point.proven_skew_ppm,
                oldest_exchange_age: point.oldest_exchange_age,
            },
            (None, None) => Self::default(),
        }
    }
}

/// Describes the interval of the drift that the exchanges prove.
fn describe_proven_drift(
    subject: &Subject<'_>,
    assumptions: &DelayAssumptions,
    skew: Option<(f64, f64)>,
) -> String {
    let Some((min, max)) = skew else {
        return "the exchanges do not prove a narrower limit than the assumed one yet".to_owned();
    };
    let between = format!("between {} and {}{SPACE}ppm", ppm(min), ppm(max));
    // The smallest absolute drift in the interval; zero or negative if the interval contains zero.
    let least = if min > 0.0 { min } else { -max };
    match assumptions.max_drift_ppm {
        Some(limit) if least > limit => format!(
            "{between}, beyond what is assumed: raise [clock] max_drift_ppm on {} above {}",
            subject.edge,
            fixed(least.ceil(), 0)
        ),
        _ => between,
    }
}

/// Describes the window of exchanges. `oldest_exchange_age` is the length of the window if the
/// window is longer than configured.
fn window_text(oldest_exchange_age: Option<Span>) -> String {
    oldest_exchange_age.map_or_else(
        || "no exchange older than [clock] window_s bounds a delay".to_owned(),
        |age| {
            format!(
                "grown to {} because exchanges are rare: the newest eight exchanges bound the delay whatever their age; if an \
                 assumption is violated, the bound is wrong for as long",
                long_duration(age.seconds())
            )
        },
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    const RAW: DelayAssumptions = DelayAssumptions {
        clocks: RelatedClocks::Raw,
        max_drift_ppm: Some(200.0),
        max_drift_change_ppm_per_s: Some(1.0),
        claims_trusted: Some(false),
        probes_authenticated: Some(true),
    };

    #[test]
    fn promise_names_every_condition() {
        let text = promise(&RAW).replace(SPACE, " ");
        assert_eq!(
            text,
            "Each interval contains the true delay as long as the free-running clocks of both hosts drift apart by at most 200 ppm, this \
             rate changes by at most 1.00 ppm per second, neither is stepped unnoticed, and no stamp is forged."
        );
        let weakest = DelayAssumptions {
            clocks: RelatedClocks::Wall,
            max_drift_ppm: None,
            max_drift_change_ppm_per_s: None,
            claims_trusted: Some(true),
            probes_authenticated: Some(false),
        };
        assert_eq!(
            promise(&weakest),
            "Each interval contains the true delay as long as the wall clocks of both hosts drift apart no faster than \
             assumed, neither is stepped unnoticed, no stamp is forged (their probes are not \
             authenticated), and the trusted claims of time daemons are true."
        );
    }

    #[test]
    fn brief_words_name_clocks_limits_and_authentication() {
        assert_eq!(
            brief_words(&RAW).replace(SPACE, " "),
            "by free-running clocks, ρ 200 ppm, κ 1.00 ppm/s, probes authenticated"
        );
        let of_earlier_release = DelayAssumptions {
            clocks: RelatedClocks::Wall,
            max_drift_change_ppm_per_s: None,
            claims_trusted: None,
            probes_authenticated: None,
            ..RAW
        };
        assert_eq!(brief_words(&of_earlier_release).replace(SPACE, " "), "by wall clocks, ρ 200 ppm");
    }
}
