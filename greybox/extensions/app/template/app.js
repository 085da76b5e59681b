"use strict";
(async () => {
  // Plotly travels packed: unpack it and run it as a script of this page.
  const packed = document.getElementById("plotly");
  const bytes = Uint8Array.from(atob(packed.textContent), (c) => c.charCodeAt(0));
  const library = document.createElement("script");
  library.textContent = await new Response(new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"))).text();
  document.head.append(library);
  packed.remove();

  const root = document.documentElement;
  const by = (id) => document.getElementById(id);
  const colour = (name) => getComputedStyle(root).getPropertyValue(name).trim();
  // Everything that is shown of a model or a record is put in as text, never as markup.
  const make = (tag, text = "", more = {}) => Object.assign(document.createElement(tag), { textContent: text }, more);
  // Sentences wrap at the width of the screen; a table, which is indented, keeps its columns.
  const answer = (name, text) => by(name).querySelector(".answer").replaceChildren(...text.split("\n\n").map((part) =>
    part.startsWith("  ") ? make("pre", part, { tabIndex: 0 }) : make("p", part)));

  let state = null;
  const shown = { record: 0, output: "", input: "", figures: {} };

  const tell = (text, good = false) => {
    by("message").textContent = text;
    by("message").className = good ? "good" : "";
    by("message").hidden = !text;
    by("gap").hidden = true;
    if (text && !good) by("message").scrollIntoView({ block: "nearest" });
  };

  const ask = async (path, body, method = "POST") => {
    let answer, content;
    try {
      const headers = body instanceof Blob ? {} : { "Content-Type": "application/json" };
      answer = await fetch(path, { method, headers, body });
      content = await answer.json();
    } catch {
      throw new Error(answer ? `The app refused this (${answer.status}).` : "The app does not answer: it has ended, or is busy. Look at its terminal.");
    }
    if (!answer.ok) throw Object.assign(new Error(content.error), { choice: content.choice, gap: content.gap });
    return content;
  };
  const act = (name, given = {}) => ask(`do/${name}`, JSON.stringify(given));

  // ---- figures -------------------------------------------------------------------------------------------------

  // A colour in a figure is the name of a variable of the page's style, so that it follows light and dark.
  const painted = (value) => {
    if (typeof value === "string") return value.startsWith("--") ? colour(value) : value;
    if (Array.isArray(value)) return value.some((v) => typeof v === "string" || (v && typeof v === "object")) ? value.map(painted) : value;
    if (value && typeof value === "object") return Object.fromEntries(Object.entries(value).map(([key, inner]) => [key, painted(inner)]));
    return value;
  };
  const narrow = () => window.innerWidth < 640;

  const draw = (id, figure, view) => {
    const plot = by(id);
    plot.hidden = !figure;
    if (!figure) return;
    const chosen = Math.max(0, figure.views.findIndex(({ name }) => name === view));
    const own = painted(figure.views[chosen].layout), kept = new Set(figure.views[chosen].traces);
    const axis = { gridcolor: colour("--line"), zerolinecolor: colour("--line"), linecolor: colour("--line"), automargin: true };
    const axes = Object.fromEntries(["xaxis", "yaxis"].map((key) => [key, { ...axis, ...own[key], title: { standoff: 10, ...own[key]?.title }, uirevision: `${shown.record} ${key === "yaxis" ? view : ""}` }]));
    plot.style.height = `${narrow() ? Math.min(figure.height, id === "run" ? 230 : 260) : figure.height}px`;
    plot.setAttribute("aria-label", figure.words);
    Plotly.react(plot, figure.data.map((trace, k) => ({ ...painted(trace), visible: kept.has(k) })), {
      margin: { l: narrow() ? 44 : 60, r: 12, t: 12, b: 40 }, hovermode: "x unified", showlegend: true, uirevision: "kept",
      legend: { orientation: "h", y: 1.02, yanchor: "bottom", x: 0 }, ...own, ...axes,
      paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)",
      font: { color: colour("--ink"), family: getComputedStyle(document.body).fontFamily, size: narrow() ? 11 : 13 },
      hoverlabel: { bgcolor: colour("--panel"), bordercolor: colour("--line"), font: { color: colour("--ink") } },
    }, { responsive: true, displaylogo: false, displayModeBar: narrow() ? false : "hover" });
  };

  const choose = (group, names, chosen, pick) => {
    by(group).replaceChildren(...(names.length < 2 ? [] : names.map((name) => {
      const button = make("button", name, { type: "button", onclick: () => pick(name) });
      button.setAttribute("aria-pressed", String(name === chosen));
      return button;
    })));
  };

  // While a constant moves, only what depends on it is drawn anew.
  const redraw = (moving = false) => {
    const { run, residual, inputs, windows } = shown.figures;
    const outputs = run ? run.views.map(({ name }) => name) : [], channels = inputs ? inputs.views.map(({ name }) => name) : [];
    if (!outputs.includes(shown.output)) shown.output = outputs[0] ?? "";
    if (!channels.includes(shown.input)) shown.input = channels[0] ?? "";
    choose("outputs", outputs, shown.output, (name) => ((shown.output = name), redraw()));
    choose("channels", channels, shown.input, (name) => ((shown.input = name), redraw()));
    draw("run", run, shown.output);
    draw("residual", residual, shown.output);
    if (moving === true) return;
    draw("windows", windows, windows?.views[0].name);
    by("drive").hidden = !inputs;
    if (by("drive").open) draw("inputs", inputs, shown.input);
  };
  by("drive").addEventListener("toggle", redraw);

  const showRun = ({ figures, misfit, overflows }, moving = false) => {
    Object.assign(shown.figures, figures);
    by("overflows").hidden = !overflows;
    const row = (cells, tag) => {
      const line = make("tr");
      line.append(...cells.map((text, k) => make(k ? tag : "th", text)));
      return line;
    };
    by("misfit").tHead.replaceChildren(row(misfit.heads, "th"));
    by("misfit").tBodies[0].replaceChildren(...misfit.rows.map((cells) => row(cells, "td")));
    redraw(moving);
  };

  // ---- one request at a time while a slider moves: the newest values win --------------------------------------------

  let wanted = null, busy = false;
  const preview = async (values) => {
    wanted = { ...wanted, ...values };
    if (busy) return;
    busy = true;
    try {
      while (wanted) {
        const values = wanted;
        wanted = null;
        showRun(await act("preview", { record: shown.record, values }), true);
        tell("");
        root.dataset.redraws = Number(root.dataset.redraws ?? 0) + 1;
      }
    } catch (error) {
      wanted = null;
      tell(error.message);
    } finally {
      busy = false;
    }
  };

  // The last look asked for wins: an answer to an earlier one is dropped.
  let look = 0;
  const lookAgain = async () => {
    const mine = ++look;
    const has = state.records.length > 0;
    by("empty").hidden = has;
    by("shown").hidden = !has;
    if (!has) return;
    shown.record = Math.min(shown.record, state.records.length - 1);
    by("record").value = String(shown.record);
    try {
      const run = await act("run", { record: shown.record });
      if (mine !== look) return;
      delete shown.figures.windows;
      shown.figures.inputs = null;
      showRun(run);
      by("where").textContent = run.overflows ? by("overflows").textContent : "…";
      if (run.overflows) return;
      const location = await act("locate", { record: shown.record });
      if (mine !== look) return;
      shown.figures.windows = location.figures.windows;
      by("where").textContent = location.text;
      redraw();
    } catch (error) {
      if (mine === look) {
        by("where").textContent = "";
        tell(error.message);
      }
    }
  };

  // ---- controls --------------------------------------------------------------------------------------------------

  const STEPS = 1000;
  const toPlace = ({ low, high, logarithmic }, value) =>
    Math.round(STEPS * (logarithmic ? Math.log(value / low) / Math.log(high / low) : (value - low) / (high - low)));
  const toValue = ({ low, high, logarithmic }, place) => {
    const share = place / STEPS, value = logarithmic ? low * (high / low) ** share : low + (high - low) * share;
    return Math.min(high, Math.max(low, Number(value.toPrecision(5))));
  };
  const short = (value) => (value && Math.abs(value) < 1e-3 ? String(Number(value.toPrecision(7))).length > 9 : false) ? value.toExponential(5).replace(/\.?0+e/, "e") : String(Number(value.toPrecision(7)));

  const constantRow = (constant) => {
    const { name, unit, description, value, fixed, interval, remark } = constant;
    const row = make("div", "", { className: fixed ? "constant fixed" : "constant" });
    row.dataset.name = name;
    const what = make("span", "", { className: "what" });
    what.append(make("b", name), make("span", unit ? ` [${unit}]` : "", { className: "unit" }));
    const number = make("input", "", { type: "number", step: "any", defaultValue: short(value) });
    number.setAttribute("aria-label", `${name}, value`);
    const slider = make("input", "", { type: "range", min: 0, max: STEPS, step: 1 });
    slider.value = toPlace(constant, value);
    slider.setAttribute("aria-label", `${name}, slider`);
    slider.addEventListener("input", () => {
      number.value = short(toValue(constant, slider.value));
      if (state.records.length) preview({ [name]: toValue(constant, slider.value) });
    });
    slider.addEventListener("change", () => take("values", { values: { [name]: toValue(constant, slider.value) } }));
    number.addEventListener("change", () => {
      number.defaultValue = number.value; // taken: an answer may replace it
      if (number.value !== "" && Number.isFinite(number.valueAsNumber)) take("values", { values: { [name]: number.valueAsNumber } });
      else number.value = short(value);
    });
    const box = make("input", "", { type: "checkbox", checked: fixed });
    box.addEventListener("change", () => take("fixed", { name, fixed: box.checked }));
    const fix = make("label", "", { className: "fix" });
    fix.append(box, "fixed");
    row.append(what, number, fix, slider);
    const words = [description, interval && `95 % ${interval}`, remark].filter(Boolean).join(" · ");
    if (words) row.append(make("p", words, { className: "describe" }));
    return row;
  };

  const item = (title, small, ...buttons) => {
    const entry = make("li"), text = make("span", title);
    for (const line of [small].flat().filter(Boolean)) text.append(make("small", line));
    const group = make("span", "", { className: "buttons" });
    group.style.margin = 0;
    group.style.flex = "none";
    group.append(...buttons);
    entry.append(text, group);
    return entry;
  };
  const button = (text, label, onclick) => {
    const one = make("button", text, { type: "button", onclick });
    one.setAttribute("aria-label", label);
    return one;
  };

  const tick = (text, label, checked, onchange) => {
    const box = make("input", "", { type: "checkbox", checked, onchange: () => onchange(box.checked) });
    box.setAttribute("aria-label", label);
    const whole = make("label");
    whole.append(box, ` ${text}`);
    return whole;
  };
  const titled = (name) => name.replaceAll("_", " ");

  const duration = (seconds) => `${Number(seconds.toPrecision(3))}\u00a0s`;
  const listCatalogue = () => {
    const words = by("filter").value.toLowerCase().split(/\s+/).filter(Boolean);
    const fits = ({ name, site, equation }) => words.every((word) => `${name} ${site} ${equation}`.toLowerCase().includes(word));
    by("catalogue").replaceChildren(...state.catalogue.filter(fits).map(({ name, site, equation }) =>
      item(name.replaceAll("_", " "), [equation, `at ${site}`], button("Add", `Add ${name}`, () => take("effect", { name, on: true })))));
  };
  by("filter").addEventListener("input", listCatalogue);

  const render = (next) => {
    if (state && next.number < state.number) return; // overtaken on its way by a newer one
    const focus = document.activeElement, focused = focus?.getAttribute("aria-label");
    state = next;
    document.title = `${state.title} · greybox`;
    by("title").textContent = state.title.replaceAll("_", " ");
    by("description").textContent = state.description;
    // What is being typed stays until it is taken, whatever answer comes meanwhile.
    const isTyping = focus?.matches(".constant input[type=number]") && focus.value !== focus.defaultValue;
    if (!isTyping) by("constants").replaceChildren(...state.constants.map(constantRow));
    by("effects").replaceChildren(...(state.effects.length ? state.effects.map(({ name, site, equation }) =>
      item(name.replaceAll("_", " "), [equation, `at ${site}`], button("Remove", `Remove ${name}`, () => take("effect", { name, on: false })))) : [make("li", "None in the model.")]));
    listCatalogue();
    by("parts").replaceChildren(...state.parts.map(({ name, meaning, known }) =>
      item(titled(name), [meaning], ...["has", "lacks"].map((key) => tick(key, `${key} ${name}`, known === key, (on) => take("part", { name, known: on ? key : "" }))))));
    by("records").replaceChildren(...state.records.map(({ name, rows, seconds, validates, notes }, record) =>
      item(name, [`${validates ? "for validation" : "is fitted"} · ${rows}\u00a0rows · ${duration(seconds)}`, ...notes],
        button(validates ? "Fit it" : "Validate", `${validates ? "Fit" : "Validate with"} ${name}`, () => take("role", { record, validates: !validates })),
        button("Remove", `Remove ${name}`, () => take("forget", { record })))));
    by("record").replaceChildren(...state.records.map(({ name, validates }, k) => make("option", validates ? `${name} (validation)` : name, { value: String(k) })));
    by("undo").disabled = !state.undo;
    by("export").disabled = !state.records.length;
    for (const name of ["fit", "discover"]) by(name).disabled = Boolean(state.job);
    by("stop").hidden = by("progress").hidden = !state.job;
    by("fit-answer").hidden = !state.fit;
    if (state.fit) answer("fit-answer", state.fit.text);
    by("stale").hidden = !state.fit || state.fit.current;
    by("discovery-answer").hidden = !state.discovery;
    if (state.discovery) {
      by("outcome").textContent = state.discovery.verdict;
      answer("discovery-answer", state.discovery.text);
      const name = state.discovery.asked;
      by("asked").hidden = !name;
      by("asked").replaceChildren(...(name ? [["has", "Yes"], ["lacks", "No"]] : []).map(([known, text]) =>
        button(`${text}: it ${known} ${titled(name)}`, `${known} ${name}, and discover again`, async () => { await take("part", { name, known }); compute("discover"); })));
    }
    for (const name of ["study", "script", "equations", "folder"]) by(name).textContent = state[name];
    if (focused && !focus.isConnected) [...document.querySelectorAll("[aria-label]")].find((e) => e.getAttribute("aria-label") === focused)?.focus({ preventScroll: true });
  };

  const take = async (name, given = {}) => {
    tell(""); // now, not with the answer: news of a computation may come before it
    try {
      render(await act(name, given));
      await lookAgain();
    } catch (error) {
      tell(error.message);
      render(state); // what was typed and refused goes back to what holds
    }
  };

  // Files that wait until a person has said which column of the first is which signal.
  let waiting = null;
  const askForColumns = (files, validates, { columns, signals }) => {
    waiting = { files, validates, matched: Object.fromEntries(signals.filter(({ matched }) => matched).map(({ name, column }) => [name, column])) };
    by("unmatched").textContent = files[0].name;
    by("signals").replaceChildren(...signals.map(({ name, unit, kind, column, stated }) => {
      const row = make("label"), list = make("select", "", { name });
      const told = make("input", "", { name: `${name} [`, value: stated, placeholder: "its unit", size: 6 });
      told.setAttribute("aria-label", `unit of the column of ${name}, where its header does not say it`);
      list.append(make("option", kind === "output" ? "not in this file" : "…", { value: "" }), ...columns.map((text) => make("option", text, { value: text })));
      list.required = kind !== "output";
      list.value = column;
      row.append(make("span", kind === name ? `${name} [${unit}]` : `${kind} ${name} [${unit}]`), list, told);
      return row;
    }));
    by("choice").hidden = false;
    by("choice").scrollIntoView({ block: "nearest" });
    by("signals").querySelector("select").focus({ preventScroll: true });
  };

  // Files that were refused for a gap: split there, they can be loaded.
  let torn = [];
  const load = async (list, validates, columns = {}) => {
    const refused = [];
    torn = [];
    tell("");
    by("choice").hidden = true;
    waiting = null;
    for (const [k, file] of list.entries()) {
      const chosen = k ? {} : columns;
      try {
        const query = new URLSearchParams({ name: file.name, validates: validates ? 1 : 0, columns: JSON.stringify(chosen) });
        render(await ask(`records?${query}`, file));
        shown.record = state.records.length - 1;
      } catch (error) {
        if (error.choice) {
          askForColumns(list.slice(k), validates, error.choice);
          // Where every signal has its column it is a unit that is not known.
          if (Object.keys(columns).length || error.choice.signals.every(({ column }) => column)) refused.push(error.message);
          break;
        }
        refused.push(error.message);
        if (error.gap) torn.push([file, validates, chosen]);
      }
    }
    tell(refused.join(" "));
    by("gap").hidden = !torn.length;
    await lookAgain();
  };
  by("choice").addEventListener("submit", (event) => {
    event.preventDefault();
    const form = new FormData(by("choice")), names = [...form.keys()].filter((name) => form.has(`${name} [`));
    // A unit that a person states belongs to the name: time [ms].
    const chosen = names.map((name) => [name, form.get(name), form.get(`${name} [`).trim()]);
    const said = chosen.filter(([name, column, unit]) => column && (unit || column !== waiting.matched[name]));
    load(waiting.files, waiting.validates, Object.fromEntries(said.map(([name, column, unit]) => [unit ? `${name} [${unit}]` : name, column])));
  });
  by("leave").addEventListener("click", () => (waiting.files.length > 1 ? load(waiting.files.slice(1), waiting.validates) : (by("choice").hidden = true)));
  by("split").addEventListener("click", async () => {
    const again = torn;
    try {
      render(await act("split"));
      tell("");
      for (const [file, validates, columns] of again) await load([file], validates, columns);
    } catch (error) {
      tell(error.message);
    }
  });
  for (const [id, validates] of [["load", false], ["load-validation", true]])
    by(id).addEventListener("change", async ({ target }) => {
      await load([...target.files], validates);
      target.value = "";
    });
  window.addEventListener("dragover", (event) => {
    event.preventDefault();
    document.body.classList.add("dragging");
  });
  window.addEventListener("dragleave", () => document.body.classList.remove("dragging"));
  window.addEventListener("drop", (event) => {
    event.preventDefault();
    document.body.classList.remove("dragging");
    load([...event.dataTransfer.files], false);
  });

  by("record").addEventListener("change", ({ target }) => {
    shown.record = Number(target.value);
    lookAgain();
  });
  by("undo").addEventListener("click", () => take("undo"));
  by("export").addEventListener("click", async () => {
    try {
      const { files, folder } = await act("export");
      by("files").replaceChildren(...files.map((file) => make("li", file)));
      tell(`Exported ${files.length} files to ${folder}`, true);
    } catch (error) {
      tell(error.message);
    }
  });

  // ---- fit and discover -------------------------------------------------------------------------------------------

  let began = 0;
  const compute = async (name) => {
    by("log").textContent = by("stage").textContent = "";
    by("log").hidden = true;
    began = Date.now();
    for (const other of ["fit", "discover"]) by(other).disabled = true;
    by("progress").hidden = false;
    by("stage").textContent = "starting …";
    await take(name);
  };
  by("fit").addEventListener("click", () => compute("fit"));
  by("discover").addEventListener("click", () => compute("discover"));
  by("stop").addEventListener("click", () => {
    by("stage").textContent = "stopping …";
    take("stop"); // what it ended with comes as news
  });
  const elapsed = () => (began ? ` · ${Math.round((Date.now() - began) / 1000)} s` : "");
  const write = (text) => {
    by("log").hidden = false;
    by("log").append(`${text}\n`);
    by("log").scrollTop = by("log").scrollHeight;
  };
  const hear = async ({ news, kind, content }) => {
    if (news === "progress")
      by("stage").textContent = `stage ${content.stage} of ${content.stages} · iteration ${content.iteration}${content.noise_ratio === null ? "" : ` · misfit ${content.noise_ratio.toPrecision(4)} × noise`}${elapsed()}`;
    else if (news === "message") write(content);
    else if (news === "refit") by("stage").textContent = `refit ${content}${elapsed()}`;
    else {
      render(await ask("state", undefined, "GET"));
      if (news === "done") {
        tell("");
        await lookAgain();
        by(kind === "discover" ? "discovery-answer" : "fit-answer").scrollIntoView({ block: "nearest" });
      } else if (news === "failed") tell(content || "The computation ended without an answer. Its terminal may say why.");
      else tell("Stopped; everything is as it was. A discovery goes on from its finished refits.", true);
    }
  };
  const stream = new EventSource("events");
  stream.onmessage = ({ data }) => hear(JSON.parse(data)).catch((error) => tell(error.message));

  // ---- light and dark ---------------------------------------------------------------------------------------------

  const dress = (dark) => {
    root.dataset.theme = dark ? "dark" : "light";
    by("theme").setAttribute("aria-pressed", String(dark));
    if (state?.records.length) redraw();
  };
  const preferred = window.matchMedia("(prefers-color-scheme: dark)");
  dress(preferred.matches);
  preferred.addEventListener("change", (event) => dress(event.matches));
  by("theme").addEventListener("click", () => dress(root.dataset.theme !== "dark"));

  try {
    render(await ask("state", undefined, "GET"));
    await lookAgain();
  } catch (error) {
    tell(error.message);
  }
  window.greyboxReady = true;
})();
