// One level.

export const title = "Level";

export async function render(root, params, app) {
  const level = await app.api.get(`/v1/levels/${params.level_id}`);
  app.setTitle(level.name);
  root.append(level.name);
}
