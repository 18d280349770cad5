// All parts of a page in one import: import { h, table, form, toast } from "../ui.js";

export * from "./ui/element.js";
export * from "./ui/format.js";
export * from "./ui/forms.js";
export * from "./ui/lists.js";
export * from "./ui/messages.js";
