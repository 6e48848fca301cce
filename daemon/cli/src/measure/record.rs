//! `run.json`: everything that is needed to repeat the run.

use std::collections::BTreeMap;

use crate::VERSION;
use peernet_agent::AgentConfig;
use peernet_agent::config::PipelineConfig;
use peernet_analysis::accuracy::Accuracy;
use peernet_analysis::actuator_results::ActuatorResults;
use peernet_analysis::deadline::Misses;
use peernet_analysis::record::{
    Clocks, Counts, FORMAT, HostRecord, ModelRecord, Placement, RunRecord, to_utc,
};
use peernet_external::exec::with_arguments;
use peernet_external::{SEED_VARIABLE, environment};
use peernet_inference::MODEL_HASH;
use peernet_stream::{Placement as ReportedPlacement, PlacementKind};
use serde_json::{Map, Value};

use super::RunRequest;
use super::recorder::RecordedRun;
use crate::foreground::AgentEnd;

/// Makes the record of a run with rows.
pub(super) fn run_record(
    request: &RunRequest,
    recorded: &RecordedRun,
    end: &AgentEnd,
    edge: String,
    missed_iterations: u64,
) -> RunRecord {
    let description = recorded.description.as_ref();
    let facts = description.map(|run| run.facts.clone()).unwrap_or_default();
    let conditions = description.map(|run| run.conditions.clone()).unwrap_or_default();
    let placement = description.map(|run| &run.placement);
    let cloud = placement.and_then(|placement| placement.peer.as_ref()).map(|name| HostRecord {
        name: name.to_string(),
        id: recorded.cloud.as_ref().map(|cloud| cloud.id),
        version: recorded.cloud.as_ref().map(|cloud| cloud.version.clone()).unwrap_or_default(),
        hardware: recorded.cloud.as_ref().map(|cloud| cloud.hardware.clone()),
        clock: recorded.cloud_clock.clone().unwrap_or_default(),
        conditions: conditions.iter().filter(|condition| condition.host == *name.as_str()).cloned().collect(),
    });
    let conditions = conditions
        .into_iter()
        // Conditions that belong to no known cloud are the edge's.
        .filter(|condition| cloud.as_ref().is_none_or(|cloud| condition.host != cloud.name));
    // Values of environment variables may be secret; the record has their names only.
    let config = request.agent.redacted();
    let pipeline = config.pipelines.first();
    RunRecord {
        format: FORMAT,
        name: pipeline.map(|pipeline| pipeline.name.to_string()).unwrap_or_default(),
        title: request.title.clone(),
        run: description.map(|run| run.run),
        started: description.map(|run| to_utc(run.started)),
        ended: recorded.ended_at.map(to_utc),
        reason: end.reason(),
        version: VERSION.to_owned(),
        command: request.command.clone(),
        // The working directory of the command, not the folder of the results.
        folder: std::env::current_dir().map(|folder| folder.display().to_string()).unwrap_or_default(),
        environment: environment(),
        network_config: request.network_config.clone(),
        edge: HostRecord {
            name: edge,
            id: recorded.edge.as_ref().map(|edge| edge.id),
            version: VERSION.to_owned(),
            hardware: recorded.edge.as_ref().map(|edge| edge.hardware.clone()),
            clock: recorded.edge_clock.clone().unwrap_or_default(),
            conditions: conditions.collect(),
        },
        cloud,
        placement: placement.map(placement_record).unwrap_or_default(),
        model: placement.filter(|placement| placement.kind != PlacementKind::None).map(|placement| {
            ModelRecord {
                name: placement.model.to_string(),
                device: placement.device.clone(),
                sha256: sha256(&facts),
            }
        }),
        facts,
        pipeline: pipeline.map_or(Value::Null, json),
        agent: agent_tables(&config),
        experiment: pipeline.and_then(|pipeline| pipeline.experiment.clone()),
        user: request.user,
        peer_timeout_s: Some(request.peer_timeout().seconds()),
        seeds: seeds(&config),
        warm_up: request.warm_up.clone(),
        counts: Counts::from_rows(&recorded.rows, missed_iterations),
        deadline_s: pipeline.and_then(PipelineConfig::deadline).map(|deadline| deadline.as_secs_f64()),
        misses: Misses::from_rows(&recorded.rows),
        actuator: ActuatorResults::from_rows(&recorded.rows),
        clocks: Clocks::from_rows(&recorded.rows),
        accuracy: Accuracy::by_column(&recorded.rows),
        units: recorded.units.clone(),
        // The trust report is made from this record and added later.
        trust: None,
    }
}

fn placement_record(reported: &ReportedPlacement) -> Placement {
    Placement {
        kind: reported.kind.name().to_owned(),
        network: reported.network.clone(),
        address: reported.address.clone(),
    }
}

/// Returns the hash of the model's file as reported by its host.
fn sha256(facts: &[(String, String)]) -> Option<String> {
    let hash_fact = facts.iter().find(|(name, _)| name == MODEL_HASH);
    hash_fact.map(|(_, hash)| hash.clone())
}

/// Returns the agent's tables without the pipeline, which is recorded separately, and without the folder of this
/// run's state.
fn agent_tables(config: &AgentConfig) -> Value {
    let mut tables = json(config);
    if let Value::Object(tables) = &mut tables {
        tables.remove("pipeline");
        if let Some(Value::Object(agent)) = tables.get_mut("agent") {
            // The folder depends on the person who starts the run, and is no setting of the measurement.
            agent.remove("state_dir");
        }
    }
    tables
}

/// Collects every number called `seed` and every seed of custom code, by the table that has it: `sensor`, `load`,
/// `actuator`, or `model.` and the model's name.
fn seeds(config: &AgentConfig) -> BTreeMap<String, u64> {
    const PIPELINE: &str = "pipeline";
    fn collect_seeds(path: &str, table: &Map<String, Value>, seeds: &mut BTreeMap<String, u64>) {
        for (key, value) in table {
            match value {
                Value::Number(seed) if key == "seed" => {
                    seeds.extend(seed.as_u64().map(|seed| (path.to_owned(), seed)));
                }
                Value::Object(env) if key == "env" => {
                    let seed = env.get(SEED_VARIABLE).and_then(Value::as_str);
                    seeds.extend(seed.and_then(|seed| Some((path.to_owned(), seed.parse().ok()?))));
                }
                Value::Object(inner) if path == PIPELINE => collect_seeds(key, inner, seeds),
                Value::Object(inner) => collect_seeds(&format!("{path}.{key}"), inner, seeds),
                _ => {}
            }
        }
    }
    let mut seeds = BTreeMap::new();
    let models = config.models.iter().map(|model| (format!("model.{}", model.name()), json(model)));
    let pipeline = config.pipelines.first().map(|pipeline| (PIPELINE.to_owned(), json(pipeline)));
    for (path, table) in models.chain(pipeline) {
        if let Value::Object(table) = table {
            collect_seeds(&path, &table, &mut seeds);
        }
    }
    seeds
}

/// Serialises a value with the arguments of programs. Arguments may be secret, but other users cannot read the file.
fn json(value: &impl serde::Serialize) -> Value {
    with_arguments(|| serde_json::to_value(value))
        .unwrap_or_else(|error| Value::String(format!("cannot be written down: {error}")))
}
