// Keeps a page live: one stream of events, figures replaced in place, a word about it when the stream is away.
(() => {
  const RETRY = 2000, SILENCE = 6500;
  const $ = (id) => document.getElementById(id);
  const tell = (name, detail) => document.dispatchEvent(new CustomEvent(name, { detail }));
  const calm = matchMedia("(prefers-reduced-motion: reduce)");
  let source = null, newest = "", heard = 0, away = false, paused = false, pending = null, shown = 0, timer = 0, status = null;

  const offset = () => Number(document.documentElement.dataset.offset) * 1000;
  const clock = (time) => new Date(time + offset()).toISOString().slice(11, 19);

  // --- replacing parts: nodes stay where they are, so that focus and selection survive
  function morph(from, to) {
    const old = Array.from(from.childNodes), fresh = Array.from(to.childNodes);
    fresh.forEach((node, index) => {
      const at = old[index];
      if (!at) { from.appendChild(node); return; }
      if (at.isEqualNode(node)) return;
      if (at.nodeType !== node.nodeType || at.nodeName !== node.nodeName) { at.replaceWith(node); return; }
      if (node.nodeType !== Node.ELEMENT_NODE) { if (at.nodeValue !== node.nodeValue) at.nodeValue = node.nodeValue; return; }
      for (const { name } of Array.from(at.attributes)) if (name !== "hidden" && !node.hasAttribute(name)) at.removeAttribute(name);
      for (const { name, value } of Array.from(node.attributes)) if (at.getAttribute(name) !== value) at.setAttribute(name, value);
      morph(at, node);
    });
    old.slice(fresh.length).forEach((node) => node.remove());
  }

  // Only parts that changed are sent: one that was not shown yet stays until there is a newer one.
  function merged(before, update) {
    if (!before) return update;
    const parts = new Map([...before.parts, ...update.parts]);
    return { ...update, parts: Array.from(parts) };
  }

  function apply() {
    timer = 0;
    if (!pending || paused || document.hidden) return;
    const update = pending;
    pending = null;
    shown = performance.now();
    if ((document.querySelector("main").dataset.layout || "") !== update.layout) { renew(); return; }
    document.title = `${update.title} · PEERNet`;
    for (const [id, html] of update.parts) waiting.set(`part-${id}`, html);
    replace();
    tell("peer-updated", update);
  }

  // --- parts out of sight wait until they come into it, or are printed
  const waiting = new Map(), unseen = new Set();
  const sight = new IntersectionObserver((entries) => {
    for (const { target, isIntersecting } of entries) {
      if (isIntersecting) unseen.delete(target.id);
      else unseen.add(target.id);
    }
    if (replace()) tell("peer-updated", { marks: [], obstacles: [] });
  });
  function watch() {
    sight.disconnect();
    waiting.clear();
    unseen.clear();
    for (const part of document.querySelectorAll("[id^=part-]")) sight.observe(part);
  }
  function replace(all = false) {
    let any = false;
    for (const [id, html] of waiting) {
      if ((unseen.has(id) && !all) || paused) continue;
      waiting.delete(id);
      const part = $(id);
      if (!part) continue;
      const template = document.createElement("template");
      template.innerHTML = html;
      // A part may share its element with something that is not live: only as many nodes as it has are its own.
      morph(part, template.content);
      any = true;
    }
    return any;
  }
  addEventListener("beforeprint", () => replace(true));
  function schedule() {
    if (timer || paused || document.hidden) return;
    timer = setTimeout(apply, calm.matches ? Math.max(0, 1000 - (performance.now() - shown)) : 0);
  }

  // --- other pipelines than before: the page is fetched again and its middle exchanged
  let renewing = false;
  async function renew() {
    if (renewing) return;
    renewing = true;
    try {
      const answer = await fetch(location.href);
      if (!answer.ok) throw new Error(`status ${answer.status}`);
      const page = new DOMParser().parseFromString(await answer.text(), "text/html");
      document.querySelector("main").replaceWith(page.querySelector("main"));
      watch();
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
      // A new stream sends every part anew: what came while the page was fetched may be older or newer than it.
      connect();
      tell("peer-renewed");
    } catch { /* tried again with the next update; that the aggregator is away is said by its stream */
    } finally {
      renewing = false;
    }
  }

  // --- the top bar
  function say(word, dot) {
    if ($("livetext").textContent !== word) $("livetext").textContent = word;
    $("livedot").className = `dot ${dot}`;
  }
  function lag() {
    const silent = (performance.now() - heard) / 1000;
    let text = "";
    if (away) text = `last data ${Math.round(silent)}\u202fs ago`;
    else if (status && status.behind_s != null) text = `${NUMBERS.fixed(status.behind_s, 1)}\u202fs behind`;
    if ($("livelag").textContent !== text) $("livelag").textContent = text;
  }
  // Clocks that are made wrong on purpose: said on every page for as long as they are.
  function clockFaults(sentences) {
    const banner = $("clock-fault");
    if (Array.from(banner.children, (line) => line.textContent).join("\n") === sentences.join("\n")) return;
    banner.replaceChildren(...sentences.map((sentence) => {
      const line = document.createElement("p");
      line.textContent = sentence;
      return line;
    }));
    banner.hidden = sentences.length === 0;
  }
  // Events are not being stored: said for as long as it is so.
  function storing(sentence) {
    const banner = $("storing");
    if (banner.textContent !== (sentence || "")) banner.textContent = sentence || "";
    banner.hidden = !sentence;
  }
  function state() {
    if (away) say("Reconnecting", "warn");
    else if (paused) say("Paused", "off");
    else if (!status || status.hosts === 0) say(status ? "Waiting" : "Live", status ? "off" : "");
    else if (status.connected === 0) say("No host reports", "warn");
    else say("Live", "");
    lag();
  }

  // --- the stream: open while the page can be seen, because a browser has six connections for all pages of a server
  function wanted() {
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
    // A new EventSource cannot send Last-Event-ID by itself: as a parameter.
    const after = newest && `&last_event_id=${encodeURIComponent(newest)}`;
    source = new EventSource(`/api/v1/live?topics=${encodeURIComponent(wanted())}${after}`);
    const on = (name, handle) => source.addEventListener(name, (event) => {
      heard = performance.now();
      newest = event.lastEventId || newest;
      back();
      handle(event.data);
    });
    on("status", (data) => { status = JSON.parse(data); clockFaults(status.rehearsals); storing(status.not_storing); state(); });
    on("page", (data) => { pending = merged(pending, JSON.parse(data)); schedule(); });
    on("picture", (data) => tell("peer-picture", JSON.parse(data)));
    on("heartbeat", () => {});
    source.addEventListener("error", lost);
  }
  // The silence of a stream begins with it.
  function resume() {
    heard = performance.now();
    connect();
  }
  function lost() {
    disconnect();
    if (leaving) return;
    setTimeout(() => { if (!source && !leaving) connect(); }, RETRY);
    if (away) return;
    away = true;
    const at = clock(Date.now());
    document.body.classList.add("away");
    $("banner").textContent = `Connection to the aggregator lost at ${at}. Trying again every 2\u202fs; the figures below are the last ones received.`;
    $("banner").hidden = false;
    // What is live says of when it is; what is stored stays as true as it was.
    const title = document.querySelector("h1[data-past], [id^=part-] h1");
    if (title) title.textContent = title.dataset.past ? `${title.dataset.past} at ${at}` : `${title.textContent} (as of ${at})`;
    state();
  }
  function back() {
    if (!away) return;
    away = false;
    document.body.classList.remove("away");
    $("banner").hidden = true;
    state();
    tell("peer-back");
  }

  let leaving = false;
  addEventListener("pagehide", () => { leaving = true; disconnect(); });
  addEventListener("pageshow", (event) => { if (event.persisted) { leaving = false; resume(); } });
  setInterval(() => {
    if (source && performance.now() - heard > SILENCE) lost();
    if (away) lag();
  }, 1000);

  document.addEventListener("peer-toggle-pause", () => {
    paused = !paused;
    const button = $("pause");
    if (button) {
      button.setAttribute("aria-pressed", String(paused));
      button.querySelector("span").textContent = paused ? "Resume" : "Pause";
    }
    state();
    tell("peer-pause", paused);
    schedule();
  });
  document.addEventListener("visibilitychange", () => {
    if (document.hidden) disconnect();
    else if (!leaving) { resume(); schedule(); }
  });

  watch();
  resume();
})();
