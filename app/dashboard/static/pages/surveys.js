// Surveys: the list, by level, and making one.

import { ago, dialog, empty, form, h, icon, pager, select, table, toast } from "../ui.js";
import { levelNames, levelOptions, noLevels } from "./level_names.js";

export const title = "Surveys";

export async function render(root, params, app) {
  const names = await levelNames(app);
  const list = h("div", {});
  let levelId = names.has(app.query.get("level_id")) ? app.query.get("level_id") : "";
  const draw = () => list.replaceChildren(pager({
    pages: app.api.pages("/v1/surveys", { limit: 50, level_id: levelId }),
    render: (items) => surveyTable(items, names),
    empty: empty(
      levelId ? "No surveys of this level" : "No surveys yet",
      "A survey holds walks with known positions; maps are built from them.",
      names.size ? createButton(app, names, levelId) : noLevels(),
    ),
  }));
  const choose = (id) => {
    levelId = id;
    app.setQuery({ level_id: id });
    draw();
  };
  root.append(
    h(
      "div",
      { class: "page-head" },
      h("h1", {}, "Surveys"),
      h("div", { class: "row" }, select("Level", levelOptions(names, "All levels"), levelId, choose), createButton(app, names, () => levelId)),
    ),
    h("section", { class: "card" }, list),
  );
  draw();
}

function surveyTable(items, names) {
  return table(
    [
      { head: "Name", cell: (survey) => h("a", { href: `#/surveys/${survey.id}` }, survey.name) },
      { head: "Level", cell: (survey) => h("a", { href: `#/levels/${survey.level_id}` }, names.get(survey.level_id)?.name ?? survey.level_id) },
      { head: "Walks", number: true, cell: (survey) => survey.n_walks },
      { head: "Created", cell: (survey) => h("time", { datetime: survey.created_at }, ago(survey.created_at)) },
    ],
    items,
    { caption: "Surveys" },
  );
}

function createButton(app, names, levelId) {
  const chosen = () => (typeof levelId === "function" ? levelId() : levelId);
  return h("button", { type: "button", class: "primary", disabled: names.size === 0, onclick: () => create(app, names, chosen()) }, icon("plus"), "New survey");
}

async function create(app, names, levelId) {
  const made = await dialog("New survey", (close) => form(
    [
      { name: "name", label: "Name", required: true, maxlength: 200, hint: "For instance the day, or who walked." },
      { name: "level_id", label: "Level", type: "select", options: levelOptions(names), value: levelId },
    ],
    async (values) => close(await app.api.post("/v1/surveys", values)),
    { submit: "Create", cancel: () => close(null) },
  ));
  if (made) {
    toast(`${made.name} was created.`, { kind: "good" });
    app.go(`/surveys/${made.id}`);
  }
}
