// Updates a page from the live stream: replaces numbers and drawings in place, and shows when the stream is disconnected.
(() => {
  // A stream without any event for SILENCE_MS counts as lost. The server sends a heartbeat every two seconds.
  const RETRY_MS = 2000, SILENCE_MS = 6500;
  const $ = (id) => document.getElementById(id);
  const dispatch = (name, detail) => document.dispatchEvent(new CustomEvent(name, { detail }));
  const reducedMotion = matchMedia("(prefers-reduced-motion: reduce)");
  let source = null, lastEventId = "", lastEventAt = 0, isDisconnected = false, paused = false, pending = null, lastUpdateAt = 0, timer = 0, status = null;

  const offset = () => Number(document.documentElement.dataset.offset) * 1000;
  const timeOfDay = (time) => new Date(time + offset()).toISOString().slice(11, 19);

  // --- replacement of parts: nodes are changed in place, so that focus and selection survive
  function morph(from, to) {
    const old = Array.from(from.childNodes), fresh = Array.from(to.childNodes);
    fresh.forEach((node, index) => {
      const at = old[index];
      if (!at) { from.appendChild(node); return; }
      if (at.isEqualNode(node)) return;
      if (at.nodeType !== node.nodeType || at.nodeName !== node.nodeName) { at.replaceWith(node); return; }
      if (node.nodeType !== Node.ELEMENT_NODE) { if (at.nodeValue !== node.nodeValue) at.nodeValue = node.nodeValue; return; }
      // `hidden` is set by the search and `open` by the user. The HTML of the server has neither.
      for (const { name } of Array.from(at.attributes)) if (name !== "hidden" && name !== "open" && !node.hasAttribute(name)) at.removeAttribute(name);
      for (const { name, value } of Array.from(node.attributes)) if (at.getAttribute(name) !== value) at.setAttribute(name, value);
      morph(at, node);
    });
    old.slice(fresh.length).forEach((node) => node.remove());
  }

  // Combines two updates that were not shown yet. The server sends only changed parts, so parts of the older update are
  // kept unless the newer update replaces them.
  function mergeUpdates(before, update) {
    if (!before) return update;
    const parts = new Map([...before.parts, ...update.parts]);
    return { ...update, parts: Array.from(parts) };
  }

  function apply() {
    timer = 0;
    if (!pending || paused || document.hidden) return;
    const update = pending;
    pending = null;
    lastUpdateAt = performance.now();
    if ((document.querySelector("main").dataset.layout || "") !== update.layout) { reloadMain(); return; }
    document.title = `${update.title} · PEERNet`;
    for (const [id, html] of update.parts) pendingParts.set(`part-${id}`, html);
    replace();
    dispatch("peernet-updated", update);
  }

  // --- parts outside the viewport are replaced when they scroll into it, or before printing
  const pendingParts = new Map(), hiddenParts = new Set();
  const visibility = new IntersectionObserver((entries) => {
    for (const { target, isIntersecting } of entries) {
      if (isIntersecting) hiddenParts.delete(target.id);
      else hiddenParts.add(target.id);
    }
    // The charts get no new data: no incidents to mark, and no reasons why a throughput has no line.
    if (replace()) dispatch("peernet-updated", { marks: [], obstacles: [] });
  });
  function observeParts() {
    visibility.disconnect();
    pendingParts.clear();
    hiddenParts.clear();
    for (const part of document.querySelectorAll("[id^=part-]")) visibility.observe(part);
  }
  function replace(all = false) {
    let hasReplaced = false;
    for (const [id, html] of pendingParts) {
      if ((hiddenParts.has(id) && !all) || paused) continue;
      pendingParts.delete(id);
      const part = $(id);
      if (!part) continue;
      const template = document.createElement("template");
      template.innerHTML = html;
      // The element of a part may also contain nodes that are not live. The nodes of the part come first.
      morph(part, template.content);
      hasReplaced = true;
    }
    return hasReplaced;
  }
  addEventListener("beforeprint", () => replace(true));
  function schedule() {
    if (timer || paused || document.hidden) return;
    // A user who prefers reduced motion sees numbers change at most once a second.
    timer = setTimeout(apply, reducedMotion.matches ? Math.max(0, 1000 - (performance.now() - lastUpdateAt)) : 0);
  }

  // --- a changed layout, such as other pipelines: the page is fetched again and its <main> replaced
  let isReloading = false;
  async function reloadMain() {
    if (isReloading) return;
    isReloading = true;
    try {
      const answer = await fetch(location.href);
      if (!answer.ok) throw new Error(`status ${answer.status}`);
      const page = new DOMParser().parseFromString(await answer.text(), "text/html");
      document.querySelector("main").replaceWith(page.querySelector("main"));
      observeParts();
      $("data")?.remove();
      if (page.getElementById("data")) document.body.appendChild(page.getElementById("data"));
      const known = new Set(Array.from(document.scripts, (script) => script.getAttribute("src")));
      for (const script of page.querySelectorAll("script[src]")) {
        if (known.has(script.getAttribute("src"))) continue;
        const added = document.createElement("script");
        added.src = script.getAttribute("src");
        added.async = false;
        document.body.appendChild(added);
      }
      // A new stream sends every part again: updates from the time of the fetch may be older or newer than the page.
      connect();
      dispatch("peernet-reloaded");
    } catch { /* The next update tries again. If the aggregator is unreachable, the stream ends and the page shows it. */
    } finally {
      isReloading = false;
    }
  }

  // --- the top bar
  function showState(word, dot) {
    if ($("livetext").textContent !== word) $("livetext").textContent = word;
    $("livedot").className = `dot ${dot}`;
  }
  function showLag() {
    const silent = (performance.now() - lastEventAt) / 1000;
    let text = "";
    if (isDisconnected) text = `last data ${Math.round(silent)}\u202fs ago`;
    else if (status && status.behind_s != null) text = `last report ${NUMBERS.fixed(status.behind_s, 1)}\u202fs ago`;
    if ($("livelag").textContent !== text) $("livelag").textContent = text;
  }
  // Injected clock faults are shown on every page while they last.
  function showClockFaults(sentences) {
    const banner = $("clock-fault");
    if (Array.from(banner.children, (line) => line.textContent).join("\n") === sentences.join("\n")) return;
    banner.replaceChildren(...sentences.map((sentence) => {
      const line = document.createElement("p");
      line.textContent = sentence;
      return line;
    }));
    banner.hidden = sentences.length === 0;
  }
  // While events are not being stored, a banner on every page says so.
  function showNotStoring(sentence) {
    const banner = $("storing");
    if (banner.textContent !== (sentence || "")) banner.textContent = sentence || "";
    banner.hidden = !sentence;
  }
  function updateState() {
    if (isDisconnected) showState("Reconnecting", "warn");
    else if (paused) showState("Paused", "off");
    else if (!status || status.hosts === 0) showState(status ? "Waiting" : "Live", status ? "off" : "");
    else if (status.connected === 0) showState("No host reports", "warn");
    else showState("Live", "");
    showLag();
  }

  // --- the stream is open only while the page is visible, because a browser has six connections for all pages of a server
  function requestedTopics() {
    const topics = document.body.dataset.topic ? [document.body.dataset.topic] : [];
    if (document.querySelector(".live-chart")) topics.push("picture");
    return topics.join(",");
  }
  function disconnect() {
    if (source) source.close();
    source = null;
  }
  function connect() {
    disconnect();
    if (document.hidden) return;
    // A new EventSource cannot send the header Last-Event-ID, so the id is sent as a parameter.
    const after = lastEventId && `&last_event_id=${encodeURIComponent(lastEventId)}`;
    source = new EventSource(`/api/v1/live?topics=${encodeURIComponent(requestedTopics())}${after}`);
    const on = (name, handle) => source.addEventListener(name, (event) => {
      lastEventAt = performance.now();
      lastEventId = event.lastEventId || lastEventId;
      handleReconnect();
      handle(event.data);
    });
    // `rehearsals` is the public name of the injected clock faults.
    on("status", (data) => { status = JSON.parse(data); showClockFaults(status.rehearsals); showNotStoring(status.not_storing); updateState(); });
    on("page", (data) => { pending = mergeUpdates(pending, JSON.parse(data)); schedule(); });
    on("picture", (data) => dispatch("peernet-picture", JSON.parse(data)));
    on("heartbeat", () => {});
    source.addEventListener("error", handleDisconnect);
  }
  // Opens the stream. The silence is measured from now on.
  function resume() {
    lastEventAt = performance.now();
    connect();
  }
  function handleDisconnect() {
    disconnect();
    if (isLeaving) return;
    setTimeout(() => { if (!source && !isLeaving) connect(); }, RETRY_MS);
    if (isDisconnected) return;
    isDisconnected = true;
    const at = timeOfDay(Date.now());
    document.body.classList.add("away");
    $("banner").textContent = `Connection to the aggregator lost at ${at}. Trying again every 2\u202fs; the figures below are the last ones received.`;
    $("banner").hidden = false;
    // The title of a live page gets the time of the last data. Titles of stored data stay valid.
    const title = document.querySelector("h1[data-past], [id^=part-] h1");
    if (title) title.textContent = title.dataset.past ? `${title.dataset.past} at ${at}` : `${title.textContent} (as of ${at})`;
    updateState();
  }
  function handleReconnect() {
    if (!isDisconnected) return;
    isDisconnected = false;
    document.body.classList.remove("away");
    $("banner").hidden = true;
    updateState();
    dispatch("peernet-reconnected");
  }

  let isLeaving = false;
  addEventListener("pagehide", () => { isLeaving = true; disconnect(); });
  addEventListener("pageshow", (event) => { if (event.persisted) { isLeaving = false; resume(); } });
  setInterval(() => {
    if (source && performance.now() - lastEventAt > SILENCE_MS) handleDisconnect();
    if (isDisconnected) showLag();
  }, 1000);

  document.addEventListener("peernet-toggle-pause", () => {
    paused = !paused;
    const button = $("pause");
    if (button) {
      button.setAttribute("aria-pressed", String(paused));
      button.querySelector("span").textContent = paused ? "Resume" : "Pause";
    }
    updateState();
    dispatch("peernet-pause", paused);
    schedule();
  });
  document.addEventListener("visibilitychange", () => {
    if (document.hidden) disconnect();
    else if (!isLeaving) { resume(); schedule(); }
  });

  observeParts();
  resume();
})();
