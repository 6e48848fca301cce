//! Test of a cloud's sessions when many pipelines want one.

use peernet_tests::LoopbackDeployment;

/// Number of pipelines of each greedy agent, and maximum number of sessions of the cloud.
const PIPELINES: usize = 16;

/// Returns the tables of `count` pipelines that use the cloud, each with the additional `keys`.
fn pipeline_tables(count: usize, keys: &str) -> String {
    (0..count)
        .map(|number| {
            format!(
                "[[pipeline]]\nname = \"line-{number}\"\nsensor = {{ kind = \"synthetic\", size_bytes = 64 }}\n\
                 placement = {{ kind = \"remote\", peer = \"tcp://127.0.0.1:{{data}}\", model = \"echo\" }}\n\
                 load = {{ mode = \"rate\", hz = 2.0 }}\n{keys}\n"
            )
        })
        .collect()
}

#[test]
fn two_greedy_agents_do_not_exclude_a_third() {
    let deployment = LoopbackDeployment::new();
    let (aggregator, api) = deployment.start_aggregator();
    let tables = format!(
        "[serve]\nlisten = \"tcp://127.0.0.1:{{data}}\"\nsession = {{ max_sessions = {PIPELINES} }}\n\
         [[model]]\nname = \"echo\"\nkind = \"echo\"\n"
    );
    let cloud = deployment.start_agent("cloud", &tables);
    cloud.wait_for("ready");
    let greedy_agents = ["first", "second"].map(|name| {
        let agent = deployment.start_agent(name, &pipeline_tables(PIPELINES, ""));
        agent.wait_for("half of the sessions that other hosts do not use; the cloud's max_sessions is 16");
        agent
    });
    let third_agent = deployment.start_agent("third", &pipeline_tables(1, "limit = { iterations = 5 }"));
    let answered = api.wait_until("/api/v1/runs", |runs| {
        let runs = runs["runs"].as_array()?;
        runs.iter().find(|run| run["reason"] == "finished").map(|run| run["counts"]["ok"].clone())
    });
    assert_eq!(answered, 5);
    for process in [third_agent].into_iter().chain(greedy_agents).chain([cloud, aggregator]) {
        assert_eq!(process.stop().code(), 0);
    }
}
