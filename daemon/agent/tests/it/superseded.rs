//! Tests that answers are acted on in the order of their samples.

use peernet_stream::{Iteration, Outcome};

use crate::harness::{Aggregator, TestAgent, assert_adds_up, value};

/// Sensor whose samples are the numbers from 1.
const COUNTER: &str = "n=0; while read -r request; do n=$((n + 1)); \
                       printf \"answer %d text/plain\\n%s\" ${#n} $n; done";
/// Model that answers with its input. The answers to odd numbers take 200 ms longer than the answers to even numbers.
const UNEVEN: &str = "while read -r word bytes rest; do n=$(head -c \"$bytes\"); \
                      if [ $((n % 2)) = 1 ]; then sleep 0.2; fi; printf \"answer %d text/plain\\n%s\" ${#n} $n; done";

/// Runs 40 iterations whose answers arrive out of order, with an actuator that writes them to a file. Returns the
/// iterations in their order, and the numbers that were acted on.
async fn run_with_actuator(actuator: &str) -> (Vec<Iteration>, Vec<u64>) {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("acted");
    let actuator = actuator.replace("FILE", &file.display().to_string());
    let tables = format!(
        "[[model]]\nname = 'uneven'\nkind = 'exec'\nworkers = 4\ncommand = '''{UNEVEN}'''\n\
         [[pipeline]]\nname = 'line'\nsensor = {{ kind = 'exec', command = '''{COUNTER}''' }}\n\
         placement = {{ kind = 'local', model = 'uneven' }}\nwarm_up = {{ iterations = 0 }}\n\
         load = {{ mode = 'rate', hz = 25.0 }}\nmax_in_flight = 8\nlimit = {{ total = 40 }}\n\
         actuator = {{ kind = 'exec', command = '''{actuator}''' }}"
    );
    let aggregator = Aggregator::start().await;
    let agent = TestAgent::start("edge", Some(&aggregator.address), &tables).await;
    let received_events = aggregator.until(|received_events| !received_events.run_ends().is_empty()).await;
    let mut iterations: Vec<Iteration> = received_events.iterations().into_iter().cloned().collect();
    iterations.sort_by_key(|iteration| iteration.number);
    agent.stop().await.expect("stops well");
    let acted = std::fs::read_to_string(&file).expect("the actuator wrote the file");
    (iterations, acted.lines().map(|line| line.parse().expect("a number")).collect())
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn older_answer_is_recorded_but_not_acted_on() {
    let actuator =
        "while read -r word bytes rest; do head -c \"$bytes\" >> FILE; echo >> FILE; echo done; done";
    let (iterations, acted) = run_with_actuator(actuator).await;
    assert!(acted.is_sorted_by(|a, b| a < b), "in the order of the samples: {acted:?}");
    assert_eq!(iterations.len(), 40);
    let mut superseded = 0;
    for iteration in &iterations {
        assert_eq!(iteration.outcome, Outcome::Ok, "the answer arrived");
        assert_adds_up(iteration);
        let was_acted_on = acted.contains(&iteration.number);
        assert_eq!(value(&iteration.tree, "actuation").is_some(), was_acted_on, "{}", iteration.number);
        assert_eq!(value(&iteration.tree, "superseded"), (!was_acted_on).then_some(1.0));
        superseded += u32::from(!was_acted_on);
    }
    assert!(superseded >= 5, "newer answers overtake the answers to odd samples: {acted:?}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn answers_that_wait_for_actuator_stay_in_order() {
    // Several answers wait while the actuator acts. The actuator has acted on an answer even if the action fails,
    // because a part of the action may have been done.
    let actuator = "while read -r word bytes rest; do n=$(head -c \"$bytes\"); echo $n >> FILE; sleep 0.06; \
                    if [ $((n % 4)) = 0 ]; then echo error stuck; else echo done; fi; done";
    let (iterations, acted) = run_with_actuator(actuator).await;
    assert!(acted.is_sorted_by(|a, b| a < b), "in the order of the samples: {acted:?}");
    for iteration in &iterations {
        let was_acted_on = acted.contains(&iteration.number);
        assert_eq!(value(&iteration.tree, "superseded").is_none(), was_acted_on, "{}", iteration.number);
        let failed = was_acted_on && iteration.number % 4 == 0;
        assert_eq!(matches!(iteration.outcome, Outcome::Failed(_)), failed, "{:?}", iteration.outcome);
    }
}

/// Writes an ONNX model and its card. The model answers with its input, a row of four bytes for each sample of a batch.
fn write_identity(folder: &std::path::Path) {
    /// Returns the field `number` of a protocol buffer (onnx.proto3) with bytes as contents.
    fn field(number: u8, contents: &[u8]) -> Vec<u8> {
        let length = u8::try_from(contents.len()).expect("short");
        [&[number << 3 | 2, length], contents].concat()
    }
    // A field of a protocol buffer with an integer.
    let integer = |number: u8, value: u8| vec![number << 3, value];
    let text = |number: u8, text: &str| field(number, text.as_bytes());
    let shape = [field(1, &text(2, "batch")), field(1, &integer(1, 4))].concat();
    // The type of the elements is uint8.
    let tensor = field(2, &field(1, &[integer(1, 2), field(2, &shape)].concat()));
    let value = |name: &str| [text(1, name), tensor.clone()].concat();
    let node = [text(1, "x"), text(2, "y"), text(4, "Identity")].concat();
    let graph =
        [field(1, &node), text(2, "identity"), field(11, &value("x")), field(12, &value("y"))].concat();
    let model = [integer(1, 8), field(7, &graph), field(8, &integer(2, 13))].concat();
    std::fs::write(folder.join("model.onnx"), model).expect("written");
    let card = "name = 'identity'\ntask = 'tensors'\n[input]\nname = 'x'\ndtype = 'uint8'\nshape = [1, 4]\n\
                [output]\nname = 'y'\ndtype = 'uint8'\nshape = [1, 4]\n";
    std::fs::write(folder.join("model.toml"), card).expect("written");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn answers_of_one_batch_are_acted_on_in_order() {
    let folder = tempfile::tempdir().expect("a folder");
    write_identity(folder.path());
    // The wait of a batch is a multiple of the period of the samples, so that a new sample often arrives while the
    // batch is computed.
    let tables = format!(
        "[[model]]\nname = 'identity'\nkind = 'onnx'\npath = {:?}\nbatch = {{ max_size = 8, max_wait_ms = 60.0 }}\n\
         [[pipeline]]\nname = 'line'\n\
         sensor = {{ kind = 'exec', command = '''while read -r request; do printf 'answer 4 application/x-tensor 1x4:u8\\nabcd'; done''' }}\n\
         placement = {{ kind = 'local', model = 'identity' }}\nwarm_up = {{ iterations = 0 }}\n\
         load = {{ mode = 'rate', hz = 100.0 }}\nmax_in_flight = 16\nlimit = {{ total = 400 }}\nactuator = {{ kind = 'log' }}",
        folder.path()
    );
    let aggregator = Aggregator::start().await;
    let agent = TestAgent::start("edge", Some(&aggregator.address), &tables).await;
    let received_events = aggregator.until(|received_events| !received_events.run_ends().is_empty()).await;
    let iterations = received_events.iterations();
    agent.stop().await.expect("stops well");
    assert_eq!(iterations.len(), 400);
    let superseded = iterations.iter().filter(|iteration| value(&iteration.tree, "superseded").is_some());
    assert_eq!(superseded.count(), 0);
    assert!(iterations.iter().all(|iteration| iteration.outcome == Outcome::Ok));
}
