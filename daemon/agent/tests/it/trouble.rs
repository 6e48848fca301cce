//! Tests of failures outside of the network.

use peernet_stream::{IncidentKind, Outcome, PipelineState};

use crate::harness::{Aggregator, TestAgent, WAIT_TIMEOUT, assert_contiguous};

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn broken_picture_fails_iteration_and_run_continues() {
    let aggregator = Aggregator::start().await;
    let folder = tempfile::tempdir().expect("a folder");
    for name in ["a.png", "b.png", "d.png"] {
        image::RgbImage::new(8, 6).save(folder.path().join(name)).expect("written");
    }
    std::fs::write(folder.path().join("c.png"), b"not a picture").expect("written");
    let tables = format!(
        "[[model]]\nname = 'echo'\nkind = 'echo'\n\
         [[pipeline]]\nname = 'line'\nplacement = {{ kind = 'local', model = 'echo' }}\n\
         sensor = {{ kind = 'images', path = '{}' }}\nwarm_up = {{ iterations = 0 }}\n\
         transforms = [{{ kind = 'resize', width = 4, height = 3 }}]\nlimit = {{ iterations = 8 }}",
        folder.path().display()
    );
    let agent = TestAgent::start("edge", Some(&aggregator.address), &tables).await;
    let received_events = aggregator.until(|received_events| !received_events.run_ends().is_empty()).await;
    assert_contiguous(&received_events.iterations());
    for iteration in received_events.iterations() {
        match &iteration.outcome {
            Outcome::Failed(reason) if iteration.number % 4 == 3 => {
                assert!(reason.contains("c.png"), "{reason}");
                assert!(iteration.tree.find(&["sensing", "capture"]).is_some(), "what was measured is kept");
            }
            outcome => assert_eq!((outcome, iteration.number % 4 != 3), (&Outcome::Ok, true)),
        }
    }
    assert_eq!(received_events.iterations().len(), 8);
    agent.stop().await.expect("stops well");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn traceback_becomes_reason_of_one_line() {
    let aggregator = Aggregator::start().await;
    let folder = tempfile::tempdir().expect("a folder");
    let code =
        "class Camera:\n    def sample(self): raise ValueError('out of\\nfocus')\n\ncamera = Camera()\n";
    std::fs::write(folder.path().join("mine.py"), code).expect("written");
    let tables = format!(
        "[[pipeline]]\nname = 'line'\nplacement = {{ kind = 'none' }}\n\
         sensor = {{ kind = 'python', object = 'mine::camera', folder = '{}' }}\n\
         warm_up = {{ iterations = 0 }}\nlimit = {{ iterations = 1 }}",
        folder.path().display()
    );
    let agent = TestAgent::start("edge", Some(&aggregator.address), &tables).await;
    let received_events = aggregator.until(|received_events| !received_events.run_ends().is_empty()).await;
    let iterations = received_events.iterations();
    let reason = iterations[0].outcome.reason().expect("the iteration failed");
    assert!(reason.contains("out of focus") && reason.contains("in sample"), "{reason}");
    assert!(!reason.contains(char::is_control), "{reason:?}");
    agent.stop().await.expect("stops well");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn cloud_learns_of_missing_iterations_at_run_end() {
    let folder = tempfile::tempdir().expect("a folder");
    image::RgbImage::new(8, 6).save(folder.path().join("a.png")).expect("written");
    std::fs::write(folder.path().join("b.png"), b"not a picture").expect("written");
    let serve = "[serve]\nlisten = 'tcp://127.0.0.1:0'\n[[model]]\nname = 'echo'\nkind = 'echo'\n";
    let cloud = TestAgent::start("cloud", None, serve).await;
    let tables = |limit: &str| {
        format!(
            "[[pipeline]]\nname = 'line'\nplacement = {{ kind = 'remote', peer = '{}' }}\n\
             sensor = {{ kind = 'images', path = '{}' }}\n\
             transforms = [{{ kind = 'resize', width = 4, height = 3 }}]\nlimit = {limit}",
            cloud.address(),
            folder.path().display()
        )
    };
    let edge = TestAgent::start("edge", None, &tables("{ total = 20 }")).await;
    let mut served = cloud.running.served_counts();
    let served = served.wait_for(|served| served.answers + served.missed >= 20);
    let served = tokio::time::timeout(WAIT_TIMEOUT, served)
        .await
        .expect("the count changes in time")
        .expect("the agent serves")
        .clone();
    assert_eq!((served.answers, served.missed), (10, 10));
    edge.stop().await.expect("stops well");

    // A run that was stopped may continue later, so its missing iterations are not counted.
    let edge = TestAgent::start("edge", None, &tables("{ total = 1000000 }")).await;
    edge.until(|_| cloud.running.served_counts().borrow().answers > 15).await;
    edge.stop().await.expect("stops well");
    let mut served = cloud.running.served_counts();
    let missed = served.wait_for(|served| served.sessions == 0);
    let missed = tokio::time::timeout(WAIT_TIMEOUT, missed)
        .await
        .expect("the session ends in time")
        .expect("the agent serves")
        .missed;
    assert_eq!(missed, 10, "only the missing iterations of the first run");
    cloud.stop().await.expect("stops well");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn missing_pictures_are_reported_once() {
    let aggregator = Aggregator::start().await;
    let folder = tempfile::tempdir().expect("a folder");
    std::fs::write(folder.path().join("a.png"), b"bytes").expect("written");
    let tables = format!(
        "[[model]]\nname = 'echo'\nkind = 'echo'\n\
         [[pipeline]]\nname = 'line'\nplacement = {{ kind = 'local', model = 'echo' }}\n\
         sensor = {{ kind = 'images', path = '{}' }}\nload = {{ mode = 'rate', hz = 200.0 }}",
        folder.path().display()
    );
    let agent = TestAgent::start("edge", Some(&aggregator.address), &tables).await;
    aggregator.until(|received_events| received_events.iterations().len() >= 3).await;
    std::fs::remove_file(folder.path().join("a.png")).expect("removed");
    let failed = |outcome: &Outcome| matches!(outcome, Outcome::Failed(_));
    let has_many_failures = |received_events: &crate::harness::ReceivedEvents| {
        received_events.iterations().iter().filter(|iteration| failed(&iteration.outcome)).count() >= 30
    };
    let received_events = aggregator.until(has_many_failures).await;
    let reported = received_events.incidents(IncidentKind::PipelineFailed);
    assert_eq!(reported.len(), 1, "{reported:?}");
    assert!(reported[0].text.contains("a.png"), "{}", reported[0].text);
    agent.until_state(|state| *state == PipelineState::Running).await;
    agent.stop().await.expect("stops well");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn pipeline_that_cannot_start_reports_reason_and_others_run() {
    let aggregator = Aggregator::start().await;
    let tables = "[[model]]\nname = 'echo'\nkind = 'echo'\n\
        [[pipeline]]\nname = 'missing-pictures'\nsensor = { kind = 'images', path = '/nowhere/at/all' }\n\
        placement = { kind = 'local', model = 'echo' }\n\
        [[pipeline]]\nname = 'unknown-model'\nsensor = { kind = 'synthetic', size_bytes = 1 }\n\
        placement = { kind = 'local', model = 'ecco' }\n\
        [[pipeline]]\nname = 'idle'\nsensor = { kind = 'synthetic', size_bytes = 1 }\nstart = 'manual'\n\
        placement = { kind = 'local', model = 'echo' }\n\
        [[pipeline]]\nname = 'valid'\nsensor = { kind = 'synthetic', size_bytes = 1 }\n\
        placement = { kind = 'local', model = 'echo' }\nlimit = { iterations = 10 }\n";
    let agent = TestAgent::start("edge", Some(&aggregator.address), tables).await;
    let received_events = aggregator
        .until(|received_events| {
            received_events.run_ends().len() == 1
                && received_events.incidents(IncidentKind::PipelineFailed).len() == 2
        })
        .await;
    assert_eq!(received_events.iterations().len(), 15, "5 iterations of warm-up, and the 10 of the limit");
    assert_eq!(received_events.incidents(IncidentKind::ModelLoaded).len(), 1);
    let live = agent.running.live_update();
    let state = |name: &str| {
        let found = live.pipelines.iter().find(|pipeline| pipeline.pipeline.as_str() == name);
        found.map(|pipeline| pipeline.state.clone()).expect("shown")
    };
    assert!(
        matches!(state("missing-pictures"), PipelineState::Failed(why) if why.contains("/nowhere/at/all"))
    );
    assert!(
        matches!(state("unknown-model"), PipelineState::Failed(why) if why.contains("ecco") && why.contains("echo"))
    );
    assert!(matches!(state("idle"), PipelineState::Waiting(why) if why.contains("manual")));
    assert_eq!(state("valid"), PipelineState::Finished);
    agent.stop().await.expect("stops well");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn timeout_names_cancelled_request_that_holds_the_worker() {
    let aggregator = Aggregator::start().await;
    let folder = tempfile::tempdir().expect("a folder");
    let code = "import time\nclass Slow:\n    def infer(self, x):\n        time.sleep(2)\n        return x\n";
    std::fs::write(folder.path().join("mine.py"), code).expect("written");
    let tables = format!(
        "[[model]]\nname = 'slow'\nkind = 'python'\nobject = 'mine::Slow'\nfolder = '{}'\n\
         [[pipeline]]\nname = 'line'\nplacement = {{ kind = 'local', model = 'slow' }}\n\
         sensor = {{ kind = 'synthetic', size_bytes = 10 }}\ntimeout_ms = 300\n\
         warm_up = {{ iterations = 0 }}\nlimit = {{ total = 2 }}",
        folder.path().display()
    );
    let agent = TestAgent::start("edge", Some(&aggregator.address), &tables).await;
    let received_events = aggregator.until(|received_events| !received_events.run_ends().is_empty()).await;
    let mut iterations = received_events.iterations();
    iterations.sort_by_key(|iteration| iteration.number);
    let reason = |index: usize| iterations[index].outcome.reason().expect("the iteration has no answer");
    assert!(reason(0).contains("if it needs longer, raise timeout_ms"), "{}", reason(0));
    let advice = "within 300 ms: it still computes an earlier request, which was cancelled and began ";
    assert!(reason(1).contains(advice), "{}", reason(1));
    agent.stop().await.expect("stops well");
}
